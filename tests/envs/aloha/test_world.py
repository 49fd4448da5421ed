import numpy as np
import pytest
from headless import run_headless
from stock import smooth_actions

from lerobot_act_chunking.envs.aloha import tasks
from lerobot_act_chunking.envs.aloha.options import CAMERAS
from lerobot_act_chunking.envs.aloha.world import (
    JOINT_NAMES,
    TASKS,
    AlohaWorld,
    sample_object_pose,
    stock_generator,
)
from lerobot_act_chunking.errors import ActChunkingError, ConfigurationError, FeatureError

POSE_SIZES = {"transfer_cube": 7, "insertion": 14, "transfer_modes": 7, "language_transfer": 21}
UPRIGHT = [0.1, 0.5, 0.05, 1.0, 0.0, 0.0, 0.0]

MIDDLES = (0.37, 0.5, 0.63)
RANGES = {  # of x and y, where they are not those of transfer_cube
    "insertion": ([[0.1, 0.4], [-0.2, 0.4]], [[0.2, 0.6], [-0.1, 0.6]]),
    "language_transfer": ([[-0.04, y - 0.02] for y in MIDDLES], [[0.04, y + 0.02] for y in MIDDLES]),
}


@pytest.fixture(scope="module", params=TASKS)
def world(request):
    return AlohaWorld(request.param)


@pytest.fixture
def cube_world():
    world = AlohaWorld("transfer_cube")
    world.reset(np.array(UPRIGHT))
    return world


def trajectory(world, seed):
    world.reset(sample_object_pose(world.task, np.random.default_rng(seed)))
    states = []
    for action in smooth_actions(world.qpos(), 40, np.random.default_rng(seed)):
        world.step(action)
        states.append(np.concatenate([world.data.qpos, world.data.qvel]))
    return np.stack(states)


def test_names_are_gym_alohas():
    from gym_aloha.constants import JOINTS

    assert list(JOINT_NAMES) == JOINTS


def test_cameras_are_the_models(world):
    assert {world.model.camera(i).name for i in range(world.model.ncam)} == set(CAMERAS)


def test_shapes_and_start(world):
    pose = sample_object_pose(world.task, np.random.default_rng(0))
    world.reset(pose)
    assert pose.shape == world.environment_state().shape == (POSE_SIZES[world.task],)
    assert np.array_equal(world.environment_state(), pose)
    gripper = (0.02239 - 0.01844) / 0.03956
    assert world.qpos() == pytest.approx(np.array([0, -0.96, 1.16, 0, -0.3, 0, gripper] * 2))
    assert np.array_equal(world.qvel(), np.zeros(14))


def test_returned_arrays_are_copies(world):
    for read in (world.qpos, world.qvel, world.environment_state):
        before = read()
        read()[:] = 99.0
        assert np.array_equal(read(), before)


def test_a_step_is_20_ms_towards_the_targets(cube_world):
    target = cube_world.qpos()
    target[1], target[6], target[13] = -0.5, 0.9, 0.1
    for _ in range(100):
        cube_world.step(target)
    assert cube_world.data.time == pytest.approx(2.0)
    assert cube_world.qpos() == pytest.approx(target, abs=0.05)


def test_reset_equals_fresh(world):
    used = trajectory(world, seed=3)
    assert np.array_equal(used, trajectory(AlohaWorld(world.task), seed=3))
    assert np.array_equal(used, trajectory(world, seed=3))


def test_worlds_do_not_share_state():
    first, second = AlohaWorld("insertion"), AlohaWorld("insertion")
    alone = trajectory(AlohaWorld("insertion"), seed=1)
    first.reset(sample_object_pose("insertion", np.random.default_rng(1)))
    second.reset(sample_object_pose("insertion", np.random.default_rng(2)))
    actions = smooth_actions(first.qpos(), 40, np.random.default_rng(1))
    for action, expected in zip(actions, alone, strict=True):
        first.step(action)
        second.step(action[::-1])
        assert np.array_equal(first.data.qpos, expected[: first.model.nq])


def test_action_limits_are_the_actuators(world):
    low, high = world.action_limits()
    assert low[[1, 6, 8, 13]] == pytest.approx([-1.85005, 0, -1.85005, 0])
    assert high[[1, 6, 8, 13]] == pytest.approx([1.25664, 1, 1.25664, 1])


@pytest.mark.parametrize("task", TASKS)
def test_poses_fill_gym_alohas_ranges(task):
    rng = np.random.default_rng(0)
    poses = np.stack([sample_object_pose(task, rng) for _ in range(400)]).reshape(400, -1, 7)
    low, high = RANGES.get(task, ([[0.0, 0.4]], [[0.2, 0.6]]))
    assert poses[..., :2].min(axis=0) == pytest.approx(np.array(low), abs=0.005)
    assert poses[..., :2].max(axis=0) == pytest.approx(np.array(high), abs=0.005)
    assert (poses[..., 2] == 0.05).all()
    assert (poses[..., 3:] == [1, 0, 0, 0]).all()


def test_unknown_task_lists_the_tasks():
    message = "unknown task 'pour'; choose one of: transfer_cube, insertion"
    with pytest.raises(ConfigurationError, match=message):
        AlohaWorld("pour")
    with pytest.raises(ConfigurationError, match=message):
        sample_object_pose("pour", np.random.default_rng(0))


def test_absent_gym_aloha_names_the_fix(monkeypatch):
    monkeypatch.setattr(tasks, "find_spec", lambda name: None)
    with pytest.raises(ConfigurationError, match="pip install gym-aloha"):
        AlohaWorld("insertion")


@pytest.mark.parametrize("seed", [-1, 2**32])
def test_seed_outside_gym_alohas_range(seed):
    with pytest.raises(ConfigurationError, match=f"seed {seed} is outside"):
        stock_generator(seed)


def test_wrong_object_poses(cube_world):
    with pytest.raises(ConfigurationError, match=r"transfer_cube has shape \(7,\).*got \(14,\)"):
        cube_world.reset(np.array(UPRIGHT * 2))
    with pytest.raises(ConfigurationError, match="unit quaternions"):
        cube_world.reset(np.array([0.1, 0.5, 0.05, 0.0, 0.0, 0.0, 0.0]))
    with pytest.raises(ConfigurationError, match="finite positions"):
        cube_world.reset(np.array([np.nan, 0.5, 0.05, 1.0, 0.0, 0.0, 0.0]))


def test_wrong_actions(cube_world):
    with pytest.raises(FeatureError, match=r"shape \(14,\), got \(7,\)"):
        cube_world.step(np.zeros(7))
    action = np.zeros(14)
    action[9] = np.nan
    with pytest.raises(FeatureError, match=r"not finite at right_arm_elbow$"):
        cube_world.step(action)


def test_divergence_is_reported(cube_world):
    cube_world.data.qvel[:] = 1e9
    with pytest.raises(ActChunkingError, match="transfer_cube simulation diverged: mjWARN_BADQ"):
        cube_world.step(np.zeros(14))
    cube_world.reset(np.array(UPRIGHT))
    cube_world.step(cube_world.qpos())


def test_stepping_imports_neither_dm_control_nor_opengl():
    program = """
import sys
import numpy as np
from lerobot_act_chunking.envs.aloha.world import AlohaWorld, sample_object_pose
world = AlohaWorld("insertion")
world.reset(sample_object_pose("insertion", np.random.default_rng(0)))
world.step(world.qpos())
assert not {"gym_aloha", "dm_control", "OpenGL", "torch", "lerobot"} & set(sys.modules)
"""
    assert run_headless(program).stderr == ""
