import numpy as np
import pytest

from lerobot_act_chunking.envs.aloha.experts import ExpertOptions, plan
from lerobot_act_chunking.envs.aloha.experts.planner import MAX_STEPS
from lerobot_act_chunking.envs.aloha.world import TASKS, AlohaWorld, sample_object_pose
from lerobot_act_chunking.errors import ConfigurationError

ARMS = [*range(6), *range(7, 13)]
GRIPPERS = [6, 13]
LEFT, RIGHT = slice(0, 6), slice(7, 13)
UPRIGHT = [1.0, 0.0, 0.0, 0.0]
POSES = {
    "transfer_cube": np.array([0.08, 0.46, 0.05, *UPRIGHT]),
    "insertion": np.array([0.13, 0.57, 0.05, *UPRIGHT, -0.16, 0.44, 0.05, *UPRIGHT]),
}
POSES["transfer_modes"] = POSES["transfer_cube"]
OTHERS = [0.0, 0.5, 0.02, *UPRIGHT] * 2  # cubes that no plan is about
POSES["language_transfer"] = np.array([0.02, 0.37, 0.05, *UPRIGHT, *OTHERS])
CORNERS = {
    "transfer_cube": [[x, y, 0.05, *UPRIGHT] for x in (0.0, 0.2) for y in (0.4, 0.6)],
    "insertion": [
        [px, py, 0.05, *UPRIGHT, sx, sy, 0.05, *UPRIGHT]
        for px, sx in ((0.1, -0.1), (0.2, -0.2))
        for py, sy in ((0.4, 0.4), (0.6, 0.6), (0.4, 0.6))
    ],
}
CORNERS["transfer_modes"] = CORNERS["transfer_cube"]
CORNERS["language_transfer"] = [[x, y, 0.05, *UPRIGHT, *OTHERS] for x in (-0.04, 0.04) for y in (0.35, 0.65)]

pytestmark = pytest.mark.parametrize("task", TASKS)


def planned(task, pose=None, seed=0, **options):
    pose = POSES[task] if pose is None else pose
    return plan(task, np.asarray(pose), ExpertOptions(**options), np.random.default_rng(seed))


def speeds(actions, columns):
    """Fastest of the columns at each step, in units per second."""
    return np.abs(np.diff(actions[:, columns], axis=0)).max(axis=1) / 0.02


def test_the_plan_fits_an_episode_and_the_actuators(task):
    world = AlohaWorld(task)
    low, high = world.model.actuator_ctrlrange[:16].T
    names = [0, 1, 2, 3, 4, 5, 8, 9, 10, 11, 12, 13]
    for pose in CORNERS[task]:
        actions = planned(task, pose).actions
        assert actions.shape[1] == 14
        assert 240 <= len(actions) <= 320
        assert np.all((actions[:, ARMS] >= low[names]) & (actions[:, ARMS] <= high[names]))
        assert np.all((actions[:, GRIPPERS] >= 0) & (actions[:, GRIPPERS] <= 1))


def test_noise_free_plans_repeat_exactly_and_draw_nothing(task):
    rng = np.random.default_rng(7)
    first = plan(task, POSES[task], ExpertOptions(), rng)
    assert rng.bit_generator.state == np.random.default_rng(7).bit_generator.state
    np.testing.assert_array_equal(first.actions, planned(task, seed=8).actions)
    np.testing.assert_array_equal(first.commands, first.actions)


def test_noise_comes_from_the_generator_alone(task):
    noisy = {"waypoint_noise": 0.01, "action_noise": 0.01}
    one, same, other = planned(task, **noisy), planned(task, **noisy), planned(task, seed=1, **noisy)
    np.testing.assert_array_equal(one.actions, same.actions)
    np.testing.assert_array_equal(one.commands, same.commands)
    assert np.abs(one.actions - other.actions).max() > 1e-3
    assert np.abs(one.commands - other.commands).max() > 1e-3


def test_action_noise_disturbs_commands_but_neither_labels_nor_grippers(task):
    clean, noisy = planned(task), planned(task, action_noise=0.02)
    np.testing.assert_array_equal(noisy.actions, clean.actions)
    np.testing.assert_array_equal(noisy.commands[:, GRIPPERS], clean.actions[:, GRIPPERS])
    disturbance = (noisy.commands - noisy.actions)[:, ARMS]
    assert np.all(disturbance.std(axis=0) > 0.005)
    assert 0.015 < disturbance.std() < 0.025


def test_waypoint_noise_leaves_the_ends_of_the_plan(task):
    clean, noisy = planned(task).actions, planned(task, waypoint_noise=0.02).actions
    assert 0.01 < np.abs(noisy - clean).max() < 0.5
    np.testing.assert_allclose(noisy[-1], clean[-1], atol=1e-9)


def test_speed_and_dwell_change_the_length(task):
    steps = len(planned(task).actions)
    assert len(planned(task, speed=1.25).actions) == pytest.approx(steps / 1.25, abs=1)
    pauses = 1 if task == "insertion" else 2
    assert len(planned(task, dwell=0.5).actions) == pytest.approx(steps + 25 * pauses, abs=1)


def test_both_arms_start_at_once_and_near_home(task):
    world = AlohaWorld(task)
    world.reset(POSES[task])
    actions = planned(task).actions
    assert np.abs(actions[0] - world.qpos())[ARMS].max() < 0.1
    np.testing.assert_allclose(actions[0, GRIPPERS[0]], world.qpos()[GRIPPERS[0]], atol=0.01)
    assert speeds(actions[:4], list(range(6)))[0] > 0.01
    assert speeds(actions[:4], list(range(7, 13)))[0] > 0.4


def test_motion_is_smooth_and_never_idle(task):
    for pose in CORNERS[task]:
        actions = planned(task, pose).actions
        velocity = np.diff(actions[:, ARMS], axis=0) / 0.02
        acceleration = np.diff(velocity, axis=0) / 0.02
        assert np.abs(velocity).max() < 3.0  # rad/s
        most = 1.3 if task == "language_transfer" else 1.0  # its cubes lie farther to the side
        assert np.abs(acceleration).max() < 9.0 * most  # rad/s^2
        assert np.abs(np.diff(acceleration, axis=0) / 0.02).max() < 60.0 * most  # rad/s^3
        idle = (speeds(actions, ARMS) < 0.05) & (speeds(actions, GRIPPERS) < 0.05)
        assert idle.mean() < 0.02


def test_neighbouring_poses_get_neighbouring_plans(task):
    start, end = np.array(CORNERS[task][0]), np.array(CORNERS[task][-1])
    # Crossing the whole field in steps of about a millimetre meets every branch there could be.
    poses = [start + (end - start) * share for share in np.linspace(0, 1, 201)]
    plans = np.stack([planned(task, pose).actions for pose in poses])
    assert np.abs(np.diff(plans, axis=0)).max() < 0.02
    np.testing.assert_array_equal(plans[..., 3], 0)
    np.testing.assert_array_equal(plans[..., 10], 0)


def test_malformed_poses_are_refused(task):
    size = len(POSES[task])
    with pytest.raises(
        ConfigurationError, match=f"object pose of {task} is {size} finite numbers.*got shape"
    ):
        planned(task, POSES[task][:-1])
    with pytest.raises(ConfigurationError, match="nan"):
        planned(task, np.where(np.arange(size) == 1, np.nan, POSES[task]))


def test_turned_objects_are_refused(task):
    pose = POSES[task].copy()
    pose[-4:] = [np.cos(0.2), 0.0, 0.0, np.sin(0.2)]
    with pytest.raises(ConfigurationError, match=r"turned by less than 0\.1 rad"):
        planned(task, pose)


def test_objects_out_of_reach_are_refused(task):
    with pytest.raises(ConfigurationError, match="the right arm cannot reach"):
        planned(task, np.concatenate([[-0.4], POSES[task][1:]]))


def test_plans_longer_than_an_episode_are_refused(task):
    with pytest.raises(
        ConfigurationError, match=f"speed=0.7 and dwell=1.0 make a plan of .* has {MAX_STEPS}"
    ):
        planned(task, speed=0.7, dwell=1.0)


def test_every_pose_of_gym_aloha_is_reachable(task):
    rng = np.random.default_rng(0)
    for _ in range(100):
        assert np.isfinite(planned(task, sample_object_pose(task, rng)).actions).all()
