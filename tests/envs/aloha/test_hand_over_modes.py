"""transfer_modes: three ways of handing the cube over, told by where it happens."""

from functools import partial
from itertools import combinations

import gymnasium as gym
import numpy as np
import pytest
from tiers import draws

from lerobot_act_chunking.envs.aloha.env import AlohaSimEnv
from lerobot_act_chunking.envs.aloha.experts import RANGES, ExpertOptions, plan
from lerobot_act_chunking.envs.aloha.modes import TOLERANCE, HandOverMode
from lerobot_act_chunking.envs.aloha.rewards import CUBE, LEFT_FINGER, RIGHT_FINGER, TABLE
from lerobot_act_chunking.envs.aloha.tasks import get_task, sample_object_pose
from lerobot_act_chunking.envs.aloha.world import AlohaWorld
from lerobot_act_chunking.envs.operators import OPERATORS, get_operator
from lerobot_act_chunking.errors import ConfigurationError

TASK = "transfer_modes"
PLACES = np.array(get_task(TASK).hand_overs)
MODES = range(len(PLACES))
PAIRS = list(combinations(MODES, 2))
BOTH_HANDS = frozenset({(CUBE, LEFT_FINGER), (CUBE, RIGHT_FINGER)})

every_mode = pytest.mark.parametrize("mode", MODES)


@pytest.fixture(scope="module")
def env():
    return AlohaSimEnv(render_mode=None, task=TASK, success="hold")


def run(env, commands, seed):
    """The info after each step of an episode, until it terminates."""
    env.reset(seed=seed)
    infos = []
    for command in commands:
        _, _, terminated, _, info = env.step(command)
        infos.append(info)
        if terminated:
            break
    return infos


def planned(env, seed, mode, task=TASK, options=None):
    env.reset(seed=seed)
    pose, rng = env.world.environment_state(), np.random.default_rng(seed)
    return plan(task, pose, options or ExpertOptions(), rng, mode=mode)


def outcomes(env, mode, seeds, operator="steady"):
    """(success, mode) at the end of each episode."""
    found = []
    for seed in seeds:
        options = get_operator(operator).episode(np.random.default_rng(seed), RANGES)
        info = run(env, planned(env, seed, mode, options=options).commands, seed)[-1]
        found.append((info["is_success"], info["mode"]))
    return found


@every_mode
def test_the_expert_goes_the_way_it_is_told(env, mode):
    assert outcomes(env, mode, range(5)) == [(True, mode)] * 5


@pytest.mark.slow
@every_mode
def test_it_does_over_many_seeds(env, mode):
    n_seeds = draws(gate=8, full=200)
    found = outcomes(env, mode, range(5000, 5000 + n_seeds))
    assert found.count((True, mode)) >= 0.99 * n_seeds


@pytest.mark.slow
@pytest.mark.parametrize("operator", [name for name in OPERATORS if name != "steady"])
def test_every_person_can_go_every_way(env, operator):
    n_seeds = draws(gate=1, full=20)
    for mode in MODES:
        found = outcomes(env, mode, range(n_seeds), operator)
        assert {way for _, way in found} == {mode}
        assert sum(success for success, _ in found) >= 0.8 * n_seeds


@pytest.mark.parametrize("success", ["touch", "hold"])
def test_the_mode_is_known_from_the_hand_over_on(success):
    env = AlohaSimEnv(render_mode=None, task=TASK, success=success)
    infos = run(env, planned(env, 5, mode=1).commands, 5)
    modes = [info["mode"] for info in infos]
    decided = modes.index(1)
    assert modes == [-1] * decided + [1] * (len(modes) - decided)
    touched = [info["success_touch"] for info in infos].index(True)
    assert decided <= touched
    assert infos[-1]["is_success"]
    assert env.reset(seed=5)[1]["mode"] == -1


def test_a_hand_over_between_the_ways_is_none_of_them(env):
    # transfer_cube's own is in the midst of them.
    info = run(env, planned(env, 5, mode=0, task="transfer_cube").commands, 5)[-1]
    assert (info["is_success"], info["mode"]) == (True, -1)


@pytest.mark.parametrize(("one", "other"), PAIRS)
def test_a_mean_of_two_ways_is_none_of_the_three(env, one, other):
    for seed in range(3):
        mean = (planned(env, seed, one).commands + planned(env, seed, other).commands) / 2
        assert run(env, mean, seed)[-1]["mode"] == -1


def test_no_way_lies_between_the_others(env):
    actions = [planned(env, 3, mode).actions for mode in MODES]
    nearest = min(rms(actions[one] - actions[other]) for one, other in PAIRS)
    for mode in MODES:
        others = [actions[each] for each in MODES if each != mode]
        assert rms(actions[mode] - np.mean(others, axis=0)) > 0.7 * nearest


def rms(difference):
    return np.sqrt(np.mean(difference**2))


def test_no_point_belongs_to_two_ways():
    for one, other in combinations(PLACES, 2):
        assert np.linalg.norm(one - other) > 2.5 * TOLERANCE


def test_ways_differ_from_the_start_on_and_only_by_being_asked_for(env):
    first = [planned(env, 7, mode).actions for mode in MODES]
    assert all(np.array_equal(first[mode], planned(env, 7, mode).actions) for mode in MODES)
    assert np.abs(first[0][0] - first[1][0]).max() < 0.01  # the first observation does not give them away
    assert min(np.abs(one[60] - other[60]).max() for one, other in combinations(first, 2)) > 0.05


@every_mode
def test_every_way_is_smooth_and_within_the_actuators(mode):
    low, high = AlohaWorld(TASK).action_limits()
    rng = np.random.default_rng(0)
    for _ in range(30):
        actions = plan(TASK, sample_object_pose(TASK, rng), ExpertOptions(), rng, mode=mode).actions
        assert np.all((actions >= low) & (actions <= high))
        velocity = np.diff(actions, axis=0) / 0.02
        assert np.abs(np.delete(velocity, [6, 13], axis=1)).max() < 3.0  # rad/s


@every_mode
@pytest.mark.parametrize("stepwise", [0, 1])
def test_no_way_point_noise_leads_out_of_reach(mode, stepwise):
    rng = np.random.default_rng(0)
    options = ExpertOptions(waypoint_noise=0.02, stepwise=stepwise)
    for _ in range(draws(gate=50, full=1000)):
        assert np.isfinite(plan(TASK, sample_object_pose(TASK, rng), options, rng, mode=mode).actions).all()


@every_mode
@pytest.mark.parametrize("off", [0.0, 0.9 * TOLERANCE])
def test_a_place_counts_within_its_tolerance(mode, off):
    rule = HandOverMode(PLACES)
    rule.update(BOTH_HANDS, PLACES[mode] + [0.0, off, 0.0])
    assert rule.mode == mode
    rule.reset()
    assert rule.mode == -1
    rule.update(BOTH_HANDS, PLACES[mode] + [0.0, 1.1 * TOLERANCE, 0.0])
    assert rule.mode == -1


@pytest.mark.parametrize(
    "contacts",
    [
        {(CUBE, RIGHT_FINGER)},
        {(CUBE, LEFT_FINGER)},
        {(CUBE, LEFT_FINGER), (CUBE, RIGHT_FINGER), (CUBE, TABLE)},
        {(LEFT_FINGER, RIGHT_FINGER), (CUBE, RIGHT_FINGER)},
        set(),
    ],
    ids=["right", "left", "on the table", "fingers that meet", "nothing"],
)
def test_only_both_hands_off_the_table_are_a_hand_over(contacts):
    rule = HandOverMode(PLACES)
    rule.update(frozenset(contacts), PLACES[0])
    assert rule.mode == -1


def test_the_first_hand_over_decides():
    rule = HandOverMode(PLACES)
    for place in (PLACES[2], PLACES[0]):
        rule.update(BOTH_HANDS, place)
        assert rule.mode == 2
    rule.reset()
    rule.update(BOTH_HANDS, PLACES.mean(axis=0))
    rule.update(BOTH_HANDS, PLACES[0])
    assert rule.mode == -1


def test_tasks_with_one_way_report_no_mode():
    for task in ("transfer_cube", "insertion"):
        assert "mode" not in AlohaSimEnv(render_mode=None, task=task).reset(seed=0)[1]


@pytest.mark.parametrize("mode", [-1, 3])
def test_an_unknown_way_is_refused(env, mode):
    with pytest.raises(
        ConfigurationError, match=f"unknown mode of transfer_modes {mode}; choose one of: 0, 1, 2"
    ):
        planned(env, 0, mode)
    with pytest.raises(ConfigurationError, match="unknown mode of transfer_cube 1; choose one of: 0"):
        planned(env, 0, 1, task="transfer_cube")


def test_vector_environments_report_the_mode_of_each(env):
    build = partial(gym.make, "aloha_sim/TransferModes-v0", render_mode=None, success="hold")
    envs = gym.vector.SyncVectorEnv([build] * 2, autoreset_mode=gym.vector.AutoresetMode.DISABLED)
    assert envs.reset(seed=[5, 5])[1]["mode"].tolist() == [-1, -1]
    commands = np.stack([planned(env, 5, mode).commands[:215] for mode in (0, 2)], axis=1)
    for command in commands:
        info = envs.step(command)[-1]
    assert info["mode"].tolist() == [0, 2]
    envs.close()
