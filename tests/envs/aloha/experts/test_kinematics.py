"""The closed form against MuJoCo's forward kinematics and mink's inverse kinematics."""

import mink
import numpy as np
import pytest

from lerobot_act_chunking.envs.aloha.experts import kinematics
from lerobot_act_chunking.envs.aloha.world import AlohaWorld
from lerobot_act_chunking.errors import ConfigurationError

_FIRST_JOINT = {"left": 0, "right": 8}  # among the coordinates of the model
_GRASP_POINT = [0.139, 0.0, 0.0]  # in the frame of the gripper link


@pytest.fixture(scope="module")
def world():
    return AlohaWorld("transfer_cube")


def random_tools(arm, count=40):
    rng = np.random.default_rng(3)
    middle = -0.1 if arm == "left" else 0.1
    low, high = [middle - 0.08, 0.4, 0.02, 0.0, -0.5], [middle + 0.08, 0.6, 0.25, 1.57, 0.5]
    return rng.uniform(low, high, size=(count, 5))


def gripper_pose(world, arm, joints):
    """Grasp point [m], finger axis and opening axis in the world, from MuJoCo."""
    first = _FIRST_JOINT[arm]
    qpos = np.zeros(world.model.nq)
    qpos[first : first + 6] = joints
    transform = mink.Configuration(world.model, qpos).get_transform_frame_to_world(
        f"vx300s_{arm}/gripper_link", "body"
    )
    axes = transform.rotation().as_matrix()
    return transform.translation() + axes @ _GRASP_POINT, axes[:, 0], axes[:, 1]


@pytest.mark.parametrize("arm", ["left", "right"])
def test_inverse_puts_mujocos_grasp_point_where_asked(world, arm):
    tools = random_tools(arm)
    for tool, joints in zip(tools, kinematics.inverse(arm, tools), strict=True):
        point, fingers, _ = gripper_pose(world, arm, joints)
        np.testing.assert_allclose(point, tool[:3], atol=1e-5)  # the MJCF writes pi as 3.1416
        np.testing.assert_allclose(-fingers[2], np.sin(tool[3]), atol=1e-5)


@pytest.mark.parametrize("arm", ["left", "right"])
def test_forward_undoes_inverse(arm):
    tools = random_tools(arm)
    for tool, joints in zip(tools, kinematics.inverse(arm, tools), strict=True):
        np.testing.assert_allclose(kinematics.forward(arm, joints), tool, atol=1e-12)


@pytest.mark.parametrize("arm", ["left", "right"])
def test_mink_finds_the_same_angles_when_it_starts_nearby(world, arm):
    body, first = f"vx300s_{arm}/gripper_link", _FIRST_JOINT[arm]
    for joints in kinematics.inverse(arm, random_tools(arm, count=5)):
        qpos = np.zeros(world.model.nq)
        qpos[first : first + 6] = joints
        task = mink.FrameTask(body, "body", position_cost=1.0, orientation_cost=1.0)
        task.set_target(mink.Configuration(world.model, qpos).get_transform_frame_to_world(body, "body"))
        found = mink.Configuration(world.model, qpos)
        found.integrate_inplace(np.linspace(-0.05, 0.05, world.model.nv), 1.0)
        for _ in range(30):
            found.integrate_inplace(mink.solve_ik(found, [task], 1.0, "daqp", damping=1e-9), 1.0)
        np.testing.assert_allclose(found.q[first : first + 6], joints, atol=1e-4)


@pytest.mark.parametrize("arm", ["left", "right"])
def test_a_vertical_tool_rolled_by_its_bearing_opens_along_y(world, arm):
    x, y = (-0.12, 0.43) if arm == "left" else (0.12, 0.57)
    tool = np.array([[x, y, 0.02, np.pi / 2, kinematics.bearing(arm, x, y)]])
    _, _, opening = gripper_pose(world, arm, kinematics.inverse(arm, tool)[0])
    np.testing.assert_allclose(np.abs(opening), [0, 1, 0], atol=1e-5)


def test_home_and_limits_are_gym_alohas(world):
    world.reset(np.array([0.1, 0.5, 0.05, 1, 0, 0, 0]))
    home = world.qpos()
    np.testing.assert_array_equal(home[:6], kinematics.HOME_JOINTS)
    np.testing.assert_array_equal(home[7:13], kinematics.HOME_JOINTS)
    bending = [
        world.model.joint(f"vx300s_left/{name}").range for name in ("shoulder", "elbow", "wrist_angle")
    ]
    np.testing.assert_array_equal(np.transpose(bending), [kinematics._LOWEST, kinematics._HIGHEST])


@pytest.mark.parametrize(
    ("x", "z"), [(-0.4, 0.2), (0.44, -0.05)], ids=["beyond the stretched arm", "under the folded one"]
)
def test_poses_out_of_reach_are_named(x, z):
    near = [0.1, 0.5, 0.2, np.pi / 2, 0.0]
    tools = np.array([near, [x, 0.5, z, np.pi / 2, 0.0]])
    with pytest.raises(
        ConfigurationError, match=rf"right arm cannot reach x={x} y=0.5 z={z} m; place objects"
    ):
        kinematics.inverse("right", tools)
