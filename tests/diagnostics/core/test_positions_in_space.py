"""Actions as points: ALOHA's grasp points against MuJoCo, other actions as they are."""

import mujoco
import numpy as np
import pytest

from lerobot_act_chunking.diagnostics.core.measures import AlohaGraspPoints, RawUnits, distances, is_aloha
from lerobot_act_chunking.envs.aloha.experts import kinematics
from lerobot_act_chunking.envs.aloha.tasks import JOINT_NAMES
from lerobot_act_chunking.envs.aloha.world import AlohaWorld

GRASP_POINT = [0.139, 0.0, 0.0]  # in the frame of the gripper link


@pytest.fixture(scope="module")
def measure():
    return AlohaGraspPoints()


def mujocos_points(actions):
    """Grasp points (n, 2, 3) [mm] with the arms' joints at these actions (n, 14), as MuJoCo has them."""
    world = AlohaWorld("transfer_cube")
    found = []
    for action in actions:
        world.data.qpos[:6], world.data.qpos[8:14] = action[:6], action[7:13]
        mujoco.mj_forward(world.model, world.data)
        bodies = [world.data.body(f"vx300s_{side}/gripper_link") for side in ("left", "right")]
        found.append([1000 * (body.xpos + body.xmat.reshape(3, 3) @ GRASP_POINT) for body in bodies])
    return np.array(found)


def test_grasp_points_are_mujocos_whatever_the_forearm_does(measure):
    actions = np.random.default_rng(0).uniform(-1.2, 1.2, (30, 14))
    np.testing.assert_allclose(measure.points(actions), mujocos_points(actions), atol=0.01)


def test_grasp_points_are_the_experts(measure):
    tool = np.array([[0.1, 0.45, 0.1, 1.0, 0.2], [0.05, 0.55, 0.03, 1.5, -0.2]])
    actions = np.zeros((2, 14))
    actions[:, 7:13] = kinematics.inverse("right", tool)
    np.testing.assert_allclose(measure.points(actions)[:, 1], 1000 * tool[:, :3], atol=0.01)


def test_any_leading_axes_and_no_grippers(measure):
    actions = np.random.default_rng(1).uniform(-1, 1, (3, 5, 4, 14))
    points = measure.points(actions)
    assert points.shape == (3, 5, 4, 2, 3)
    np.testing.assert_allclose(points[2, 1, 3], measure.points(actions[2, 1, 3]))
    actions[..., [6, 13]] += 0.5
    np.testing.assert_array_equal(measure.points(actions), points)


def test_the_distance_is_that_of_the_farther_arm(measure):
    action = np.zeros(14)
    turned = action.copy()
    turned[7] += 0.001  # waist of the right arm
    apart = np.linalg.norm(measure.points(turned) - measure.points(action), axis=-1)
    assert apart[0] == 0
    assert apart[1] > 0.5
    assert distances(measure.points(turned), measure.points(action)) == apart[1]


def test_raw_units_are_the_actions_themselves():
    measure = RawUnits(("x", "y", "z"))
    one, other = np.array([[0.0, 1.0, 2.0]]), np.array([[0.5, 0.0, 2.0]])
    assert distances(measure.points(one), measure.points(other)).tolist() == [1.0]
    assert measure.unit == "raw units"


def test_aloha_is_known_by_its_joints():
    assert is_aloha(JOINT_NAMES)
    assert is_aloha([name.replace("_arm", "") for name in JOINT_NAMES])
    assert not is_aloha(JOINT_NAMES[::-1])
    assert not is_aloha([f"joint_{i}" for i in range(14)])
    assert not is_aloha(["x", "y"])
