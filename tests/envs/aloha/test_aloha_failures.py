"""What an ALOHA episode says of its failure: experts with planted defects, and made-up contacts."""

import re
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from lerobot.envs.factory import make_env
from tiers import draws

from lerobot_act_chunking.diagnostics.core.worlds import failure_of
from lerobot_act_chunking.envs.aloha.env import AlohaSimEnv
from lerobot_act_chunking.envs.aloha.experts import ExpertOptions, plan
from lerobot_act_chunking.envs.aloha.failures import FAILURES, LIFTED, STEADY_STEPS, Hold, make_progress
from lerobot_act_chunking.envs.aloha.rewards import CUBE, LEFT_FINGER, PEG, PIN, RIGHT_FINGER, TABLE
from lerobot_act_chunking.envs.aloha.tasks import TASKS
from lerobot_act_chunking.envs.configuration_envs import AlohaSimEnvConfig
from lerobot_act_chunking.errors import ConfigurationError

LEFT, LEFT_GRIPPER, RIGHT_WAIST, RIGHT_GRIPPER = slice(0, 7), 6, 7, 13
SEEDS = range(draws(gate=2, full=10))
IN_AIR, HIGH, LOW = frozenset({(CUBE, RIGHT_FINGER)}), LIFTED + 0.01, LIFTED - 0.01
HELD = frozenset({(PEG, RIGHT_FINGER), ("socket-1", LEFT_FINGER)})
GIVEN, TAKEN = frozenset({(CUBE, RIGHT_FINGER), (LEFT_FINGER, CUBE)}), frozenset({(CUBE, LEFT_FINGER)})


def expert(env, *, shift=0.0):
    """The commands (T, 14) of an expert that sees every object ``shift`` [m] to one side."""
    pose = env.world.environment_state()
    pose[1::7] += shift
    return plan(env.task, pose, ExpertOptions(), np.random.default_rng(0)).commands.copy()


def beside(env):
    return expert(env, shift=-0.12)


def after(seconds, joints, value):
    """The expert with these joints at ``value`` from ``seconds`` on."""

    def commands(env):
        planned = expert(env)
        planned[round(50 * seconds) :, joints] = value
        return planned

    return commands


def without_left_arm(env):
    planned = expert(env)
    planned[:, LEFT] = planned[0, LEFT]
    return planned


def until(seconds):
    """The expert that stops there and stays."""

    def commands(env):
        planned = expert(env)
        planned[round(50 * seconds) :] = planned[round(50 * seconds)]
        return planned

    return commands


def pulled_out(env):
    planned = expert(env)
    planned[198:] = planned[198 : 2 * 198 - len(planned) : -1]  # it meets the pin at 194
    return planned


def aside(env):
    planned = expert(env)
    planned[145:, RIGHT_WAIST] += 0.06  # moves the peg by 2 cm, once it is lifted
    return planned


DEFECTS = [
    ("transfer_cube", "touch", "no contact", beside),
    ("transfer_cube", "touch", "missed grasp", after(1.86, RIGHT_GRIPPER, 1.0)),
    ("transfer_cube", "touch", "dropped", after(2.3, RIGHT_GRIPPER, 1.0)),
    ("transfer_cube", "touch", "no hand-over", without_left_arm),
    ("transfer_cube", "hold", "no hand-over", after(4.2, LEFT_GRIPPER, 1.0)),  # gives it back
    ("transfer_cube", "hold", "not released", until(4.0)),
    ("insertion", "touch", "no contact", beside),
    ("insertion", "touch", "missed grasp", after(1.2, RIGHT_GRIPPER, 1.0)),
    ("insertion", "touch", "missed grasp", after(1.2, LEFT_GRIPPER, 1.0)),
    ("insertion", "touch", "dropped", after(2.8, RIGHT_GRIPPER, 1.0)),
    ("insertion", "touch", "dropped", after(2.8, LEFT_GRIPPER, 1.0)),
    ("insertion", "touch", "not joined", until(2.9)),
    ("insertion", "touch", "misaligned", aside),
    ("insertion", "hold", "unsteady hold", pulled_out),
]


@pytest.fixture
def make():
    """Make environments that are closed after the test."""
    made = []

    def build(**options):
        made.append(AlohaSimEnv(render_mode=None, **options))
        return made[-1]

    yield build
    for env in made:
        env.close()


def told(env, commands):
    """What ``env`` says after each step; the episode ends with the commands or the success."""
    labels = []
    for command in commands:
        terminated = env.step(command)[2]
        labels.append(failure_of(env))
        if terminated:
            break
    return labels


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("task", "rule", "label", "defect"), DEFECTS)
def test_planted_defects_are_called_by_their_names(make, task, rule, label, defect, seed):
    env = make(task=task, success=rule)
    env.reset(seed=seed)
    assert told(env, defect(env))[-1] == label


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("task", [each for each in TASKS if each != "language_transfer"])  # as transfer_cube
@pytest.mark.parametrize("rule", ["touch", "hold"])
def test_an_expert_passes_the_stages_in_order_and_ends_without_a_failure(make, task, rule, seed):
    env = make(task=task, success=rule)
    env.reset(seed=seed)
    labels = told(env, expert(env))
    stages = [*FAILURES[task], None]
    ranks = [stages.index(label) for label in labels]
    assert ranks == sorted(ranks)
    passed = set(FAILURES[task]) - {"dropped", "misaligned"}
    late = {"not released", "unsteady hold"} if rule == "touch" else set()
    assert set(labels) - {"misaligned"} == passed - late | {None}


def test_success_under_touch_is_none_while_hold_still_misses_it(make):
    touch, hold = make(task="transfer_cube"), make(task="transfer_cube", success="hold")
    for env in (touch, hold):
        env.reset(seed=0)
    for command in expert(touch):
        hold.step(command)
        if touch.step(command)[2]:
            break
    assert (touch.failure, hold.failure) == (None, "no hand-over")


def test_reset_forgets(make):
    env = make(task="transfer_cube")
    assert env.failure == "no contact"
    for commands in (expert, after(2.3, RIGHT_GRIPPER, 1.0)):
        env.reset(seed=1)
        told(env, commands(env))
        assert env.failure != "no contact"
        env.reset()
        assert env.failure == "no contact"


def test_wrapped_vectorized_and_alone_say_the_same(make):
    alone = [make(task="insertion"), make(task="insertion")]
    for seed, env in enumerate(alone):
        env.reset(seed=seed)
    commands = np.stack([expert(alone[0])[:200], after(1.2, RIGHT_GRIPPER, 1.0)(alone[1])[:200]], axis=1)
    expected = [told(env, commands[:, i]) for i, env in enumerate(alone)]
    assert expected[0][-1] != expected[1][-1]

    wrapped = gym.make("aloha_sim/Insertion-v0", render_mode=None)
    wrapped = gym.wrappers.RecordEpisodeStatistics(wrapped)
    wrapped.reset(seed=0)
    assert told(wrapped, commands[:, 0].astype(np.float32)) == expected[0]
    wrapped.close()

    vector = make_env(AlohaSimEnvConfig(task="insertion"), n_envs=2)["aloha_sim"][0]
    vector.reset(seed=[0, 1])
    for step, pair in enumerate(commands[: len(expected[0]) - 1]):
        vector.step(pair)
        assert vector.call("failure") == (expected[0][step], expected[1][step])
    vector.close()


def test_a_hold_begins_and_ends_with_steady_contacts_alone():
    hold = Hold("right", (CUBE,))
    for contacts in [IN_AIR, frozenset()] * STEADY_STEPS:
        hold.update(contacts, HIGH)
    assert (hold.touched, hold.holds, hold.lifted) == (True, False, False)
    for _ in range(STEADY_STEPS):
        assert not hold.holds
        hold.update(IN_AIR, HIGH)
    assert (hold.holds, hold.lifted) == (True, True)
    for contacts in [frozenset(), IN_AIR] * STEADY_STEPS:
        hold.update(contacts, HIGH)
        assert hold.holds
    for _ in range(STEADY_STEPS):
        assert hold.holds
        hold.update(frozenset(), HIGH)
    assert (hold.holds, hold.lifted) == (False, True)


@pytest.mark.parametrize(
    ("contacts", "height", "state"),
    [
        ({(RIGHT_FINGER, CUBE)}, HIGH, (True, True, True)),
        ({(CUBE, "vx300s_right/10_left_gripper_finger")}, HIGH, (True, True, True)),
        ({(CUBE, RIGHT_FINGER)}, LOW, (True, True, False)),
        ({(CUBE, RIGHT_FINGER), (TABLE, CUBE)}, HIGH, (True, False, False)),
        ({(CUBE, "vx300s_right/7_gripper")}, HIGH, (True, False, False)),
        ({(CUBE, "vx300s_right/2_shoulder")}, HIGH, (False, False, False)),
        ({(CUBE, LEFT_FINGER)}, HIGH, (False, False, False)),
        (set(), HIGH, (False, False, False)),
    ],
)
def test_what_touches_holds_and_lifts(contacts, height, state):
    hold = Hold("right", (CUBE,))
    for _ in range(2 * STEADY_STEPS):
        hold.update(frozenset(contacts), height)
    assert (hold.touched, hold.holds, hold.lifted) == state


@pytest.mark.parametrize(
    ("episode", "label"),
    [
        ([IN_AIR, GIVEN, TAKEN], "unsteady hold"),
        ([IN_AIR, GIVEN, IN_AIR], "no hand-over"),
        ([IN_AIR, GIVEN, TAKEN, frozenset()], "dropped"),
        ([TAKEN], "unsteady hold"),
        ([frozenset({(CUBE, LEFT_FINGER), (CUBE, TABLE)})], "no contact"),
    ],
)
def test_who_has_the_cube_now(episode, label):
    progress = make_progress("transfer_cube")
    for contacts in episode:
        for _ in range(STEADY_STEPS):
            progress.update(contacts, [HIGH])
    assert progress.failure == label


@pytest.mark.parametrize(
    ("met", "label"),
    [
        (set(), "not joined"),
        ({("socket-2", PEG)}, "misaligned"),
        ({(PEG, "socket-2"), (PEG, PIN)}, "unsteady hold"),
        ({(PIN, PEG)}, "unsteady hold"),
    ],
)
def test_parts_meet_only_where_both_are_held(met, label):
    progress = make_progress("insertion")
    for _ in range(STEADY_STEPS):
        progress.update(frozenset(met), [HIGH, HIGH])
    for _ in range(STEADY_STEPS):
        progress.update(HELD, [HIGH, HIGH])
    assert progress.failure == "not joined"
    progress.update(HELD | met, [HIGH, HIGH])
    assert progress.failure == label
    for _ in range(STEADY_STEPS):
        progress.update(HELD - {(PEG, RIGHT_FINGER)}, [HIGH, HIGH])
    assert progress.failure == "dropped"


@pytest.mark.parametrize("heights", [(HIGH, LOW), (LOW, HIGH)])
def test_one_lifted_part_of_two_is_a_missed_grasp(heights):
    progress = make_progress("insertion")
    for _ in range(STEADY_STEPS):
        progress.update(HELD, heights)
    assert progress.failure == "missed grasp"


def test_failures_are_those_of_the_tasks():
    assert tuple(FAILURES) == TASKS
    assert FAILURES["transfer_modes"] == FAILURES["transfer_cube"]
    with pytest.raises(ConfigurationError, match="unknown task 'pour'; choose one of: transfer_cube"):
        make_progress("pour")


def test_the_guide_lists_all_of_them_in_order():
    guide = (Path(__file__).parents[3] / "docs/guides/evaluate.md").read_text()
    labels = [*FAILURES["transfer_cube"], *FAILURES["insertion"]]
    of_aloha = guide[: guide.index("| `pick_place`")]
    assert [cell for cell in re.findall(r"`([a-z -]+)` \|", of_aloha) if cell in labels] == labels
