# pyright: reportAttributeAccessIssue=false
# (mujoco ships no type stubs)
"""gym-aloha's physics on raw MuJoCo: same models, actions and substep order, no dm_control, no OpenGL."""

import mujoco
import numpy as np

from lerobot_act_chunking.envs.aloha.rewards import CUBE, Contacts
from lerobot_act_chunking.envs.aloha.tasks import (
    JOINT_NAMES,
    TASKS,
    get_task,
    mjcf_path,
    sample_object_pose,
    stock_generator,
)
from lerobot_act_chunking.errors import ActChunkingError, ConfigurationError, FeatureError

__all__ = ["JOINT_NAMES", "TASKS", "AlohaWorld", "sample_object_pose", "stock_generator"]

CONTROL_PERIOD = 0.02
"""Time between two actions [s]."""

_START_ARM = (0.0, -0.96, 1.16, 0.0, -0.3, 0.0, 0.02239, -0.02239)
_ROBOT_SIZE = 16  # model coordinates: two arms of six joints and two mirrored fingers
_FINGER_CLOSED = 0.01844  # finger travel [m] that counts as gripper 0
_FINGER_SPAN = 0.05800 - _FINGER_CLOSED
# Where each of the 14 named joints sits among the 16: the second finger mirrors the first and is left out.
_NAMED = np.array([0, 1, 2, 3, 4, 5, 6, 8, 9, 10, 11, 12, 13, 14])
_GRIPPERS = np.array([6, 13])  # among the 14
_SHAPE = ("type", "size", "condim", "solimp", "solref", "friction")
_RGBA = {"green": (0, 0.6, 0, 1), "blue": (0, 0, 1, 1)}


class AlohaWorld:
    """One ALOHA cell with its objects; every piece of state lives in ``model`` and ``data``.

    Args:
        task: one of ``TASKS``.

    Raises:
        ConfigurationError: unknown task, or gym-aloha is not installed.
    """

    def __init__(self, task: str) -> None:
        self.task = task
        self._task = get_task(task)
        self.model = _model(task)
        self.data = mujoco.MjData(self.model)
        self._geom_names = [self.model.geom(i).name for i in range(self.model.ngeom)]
        self._substeps = round(CONTROL_PERIOD / self.model.opt.timestep)
        self._warnings = self.data.warning.number

    def reset(self, object_pose: np.ndarray) -> None:
        """Place the arms in their start pose and the objects at ``object_pose``.

        Args:
            object_pose: (7,), (14,) or (21,), x y z [m] and unit quaternion qw qx qy qz per object.

        Raises:
            ConfigurationError: wrong shape, not finite, or a quaternion that is not of unit length.
        """
        pose = self._checked_pose(object_pose)
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:_ROBOT_SIZE] = _START_ARM * 2
        self.data.qpos[_ROBOT_SIZE:] = pose
        self.data.ctrl[:] = _START_ARM * 2
        mujoco.mj_forward(self.model, self.data)

    def step(self, action: np.ndarray) -> None:
        """Advance one control period (20 ms) towards the joint targets.

        Args:
            action: (14,), order of ``JOINT_NAMES``: joint targets [rad], grippers 0 (closed) to 1 (open).
                MuJoCo clips targets to the actuators' range.

        Raises:
            FeatureError: wrong shape or not finite.
            ActChunkingError: the simulation diverged.
        """
        self._set_targets(self._checked_action(action))
        # dm_control's order for Euler: finish the step begun by the last mj_step1, so that observations,
        # contacts and images always belong to the newest positions.
        mujoco.mj_step2(self.model, self.data)
        mujoco.mj_step(self.model, self.data, self._substeps - 1)
        mujoco.mj_step1(self.model, self.data)
        if self._warnings.any():
            raise ActChunkingError(f"the {self.task} simulation diverged: {self._warning_names()}")

    def qpos(self) -> np.ndarray:
        """Joint positions (14,) float64: rad, grippers normalised like actions."""
        positions = self.data.qpos[_NAMED]
        positions[_GRIPPERS] = (positions[_GRIPPERS] - _FINGER_CLOSED) / _FINGER_SPAN
        return positions

    def qvel(self) -> np.ndarray:
        """Joint velocities (14,) float64: rad/s, grippers in openings per second."""
        velocities = self.data.qvel[_NAMED]
        velocities[_GRIPPERS] /= _FINGER_SPAN
        return velocities

    def environment_state(self) -> np.ndarray:
        """Object poses (7,), (14,) or (21,) float64: x y z [m], qw qx qy qz per object."""
        return self.data.qpos[_ROBOT_SIZE:].copy()

    def heights(self) -> list[float]:
        """Height [m] of each object's centre over the table."""
        return self.data.qpos[_ROBOT_SIZE + 2 :: 7].tolist()

    def action_limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest action, (14,) each: the actuators' range [rad], 0 and 1 for the grippers."""
        limits = self.model.actuator_ctrlrange[_NAMED]
        limits[_GRIPPERS] = 0.0, 1.0
        return limits[:, 0], limits[:, 1]

    def contacts(self) -> Contacts:
        """Names of the geoms that touch now, as pairs in MuJoCo's order."""
        names = self._geom_names
        return frozenset((names[a], names[b]) for a, b in self.data.contact.geom.tolist())

    def stock_reward(self) -> int:
        """gym-aloha's reward 0 .. 4; 4 is its success."""
        return self._task.reward(self.contacts())

    def _set_targets(self, action: np.ndarray) -> None:
        # Stay in the action's own precision, as gym-aloha does: float32 actions then give the same targets.
        left, right = action[6] * _FINGER_SPAN + _FINGER_CLOSED, action[13] * _FINGER_SPAN + _FINGER_CLOSED
        targets = self.data.ctrl
        targets[:6], targets[6], targets[7] = action[:6], left, -left
        targets[8:14], targets[14], targets[15] = action[7:13], right, -right

    def _checked_action(self, action: np.ndarray) -> np.ndarray:
        action = np.asarray(action)
        if action.shape != (len(JOINT_NAMES),):
            raise FeatureError(f"an action has shape {(len(JOINT_NAMES),)}, got {action.shape}")
        if not np.isfinite(action).all():
            bad = [name for name, value in zip(JOINT_NAMES, action, strict=True) if not np.isfinite(value)]
            raise FeatureError(f"the action is not finite at {', '.join(bad)}")
        return action

    def _checked_pose(self, object_pose: np.ndarray) -> np.ndarray:
        pose = np.asarray(object_pose, dtype=np.float64)
        size = self._task.pose_size
        if pose.shape != (size,):
            raise ConfigurationError(
                f"the object pose of {self.task} has shape {(size,)}, x y z qw qx qy qz per object; "
                f"got {pose.shape}"
            )
        lengths = np.linalg.norm(pose.reshape(-1, 7)[:, 3:], axis=1)
        if not (np.isfinite(pose).all() and np.allclose(lengths, 1.0, atol=1e-3)):
            raise ConfigurationError(
                f"the object pose {pose.tolist()} needs finite positions and unit quaternions (qw qx qy qz)"
            )
        return pose

    def _warning_names(self) -> str:
        return ", ".join(mujoco.mjtWarning(i).name for i in np.flatnonzero(self._warnings))


def _model(task: str) -> mujoco.MjModel:
    """gym-aloha's model of the task; of several cubes, all are like its own."""
    path, cubes = str(mjcf_path(task)), get_task(task).cubes
    if not cubes:
        return mujoco.MjModel.from_xml_path(path)
    spec = mujoco.MjSpec.from_file(path)
    for key in list(spec.keys):  # of one cube
        spec.delete(key)
    original = spec.geom(CUBE)
    for colour in cubes[1:]:
        body = spec.worldbody.add_body(name=f"{colour}_cube")
        body.add_freejoint(name=f"{colour}_box_joint")
        body.explicitinertial, body.mass, body.inertia = True, original.parent.mass, original.parent.inertia
        shape = {name: getattr(original, name) for name in _SHAPE}
        body.add_geom(name=f"{colour}_box", rgba=_RGBA[colour], **shape)
    for joint in spec.joints:
        if joint.name.endswith("_box_joint"):
            joint.frictionloss = spec.joint("red_box_joint").frictionloss
    return spec.compile()
