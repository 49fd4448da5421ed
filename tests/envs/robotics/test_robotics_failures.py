"""What an episode of a Fetch task says of its failure: experts with planted defects, and moved objects."""

import re
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from lerobot.envs.factory import make_env
from tiers import draws

from lerobot_act_chunking.diagnostics.core.worlds import failure_of
from lerobot_act_chunking.envs.configuration_robotics import RoboticsEnvConfig
from lerobot_act_chunking.envs.demonstration import ExpertOptions
from lerobot_act_chunking.envs.robotics.env import RoboticsEnv
from lerobot_act_chunking.envs.robotics.experts import Expert
from lerobot_act_chunking.envs.robotics.failures import FAILURES, LIFTED, MOVED, Progress
from lerobot_act_chunking.envs.robotics.tasks import TASKS

PICK, PUSH, SLIDE = "FetchPickAndPlace-v4", "FetchPush-v4", "FetchSlide-v4"
SEEDS = range(draws(gate=2, full=10))
CLOSE, OPEN = -1.0, 1.0
BESIDE = np.array([0.1, 0.0, 0.0])
REST = 0.425  # height [m] of a block that lies on the table


@pytest.fixture
def make():
    """Make environments that are closed after the test."""
    made = []

    def build(task, **options):
        made.append(RoboticsEnv(render_mode=None, task=task, **options))
        return made[-1]

    yield build
    for env in made:
        env.close()


def told(env, act):
    """What ``env`` says after each step of an episode of ``act(step, the expert's action, state)``."""
    expert = Expert(env.task, ExpertOptions(), np.random.default_rng(0), env.max_episode_steps)
    labels, over = [], False
    while not over:
        state = env.named_state
        _, _, terminated, truncated, _ = env.step(act(len(labels), expert.act(state)[0], state))
        labels.append(failure_of(env))
        over = terminated or truncated
    return labels


def begin_with_a_goal_in_the_air(env, seed):
    env.reset(seed=seed)
    while env.named_state["desired_goal"][2] < REST + 0.15:
        env.reset()


def put(env, place):
    """Move the object; it lies still."""
    pose = env.original._utils.get_joint_qpos(env.original.model, env.original.data, "object0:joint")
    pose[:2] = place[:2]
    env.original._utils.set_joint_qpos(env.original.model, env.original.data, "object0:joint", pose)
    env.step(np.zeros(4))


def demonstrated(step, action, state):
    return action


def still(step, action, state):
    return np.zeros(4)


def open_fingers(step, action, state):
    return np.append(action[:3], OPEN)


def closed_fingers(step, action, state):
    return np.append(action[:3], CLOSE)


def lets_go(step, action, state):
    return action if step < 30 else np.append(action[:3], OPEN)


def stops(step, action, state):
    return action if state["object_pos"][2] < REST + 0.04 else np.array([0, 0, 0, CLOSE])


def leaves(step, action, state):
    return action if step < 40 else np.array([-1, -1, 0, CLOSE])


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(
    ("act", "label"),
    [
        (still, "no contact"),
        (open_fingers, "missed grasp"),
        (closed_fingers, "missed grasp"),
        (lets_go, "dropped"),
        (stops, "missed the goal"),
        (leaves, "overshot"),
        (demonstrated, None),
    ],
)
def test_picking_with_planted_defects(make, act, label, seed):
    env = make(PICK, success="final")
    begin_with_a_goal_in_the_air(env, seed)
    assert told(env, act)[-1] == label


@pytest.mark.parametrize("seed", SEEDS)
def test_picking_passes_the_stages_in_order(make, seed):
    env = make(PICK, success="any")
    begin_with_a_goal_in_the_air(env, seed)
    labels = told(env, demonstrated)
    assert list(dict.fromkeys(labels)) == ["no contact", "missed grasp", "missed the goal", None]


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("task", [PUSH, SLIDE])
def test_an_object_on_the_table(make, task, seed):
    env = make(task, success="final")
    env.reset(seed=seed)
    while np.linalg.norm(env.named_state["desired_goal"] - env.named_state["object_pos"]) < 0.1:
        env.reset()
    goal = env.named_state["desired_goal"]
    labels = [failure_of(env)]
    for place in (env.named_state["object_pos"], goal + BESIDE, goal, goal + BESIDE, goal):
        put(env, place)
        labels.append(failure_of(env))
    assert labels == ["no contact", "no contact", "missed the goal", None, "overshot", None]


@pytest.mark.parametrize("seed", SEEDS)
def test_pushing_with_planted_defects(make, seed):
    env = make(PUSH, success="final")
    env.reset(seed=seed)
    assert told(env, demonstrated)[-1] is None
    env.reset(seed=seed)
    assert told(env, still)[-1] == "no contact"
    env.reset(seed=seed)
    env.original.goal = env.original.goal + np.array([0, 0, 1])  # the expert does not look up
    assert told(env, demonstrated)[-1] == "missed the goal"


def test_success_at_any_step_stays_one(make):
    env = make(PUSH, success="any")
    env.reset(seed=0)
    goal = env.named_state["desired_goal"]
    put(env, goal)
    put(env, goal + BESIDE)
    assert env.failure is None
    env.reset(seed=0)
    assert env.failure == "no contact"


def test_wrapped_vectorized_and_alone_say_the_same(make):
    alone = [make(PICK, success="final"), make(PICK, success="final")]
    for seed, env in enumerate(alone):
        env.reset(seed=seed)
    actions = []

    def noted(step, action, state):
        actions.append(action)
        return action

    expected = [told(alone[0], noted), told(alone[1], still)]
    assert len(set(expected[0])) > len(set(expected[1])) == 1

    wrapped = gym.make(f"gymnasium_robotics/{PICK}", success="final", render_mode=None)
    wrapped = gym.wrappers.RecordEpisodeStatistics(wrapped)
    vector = make_env(RoboticsEnvConfig(task=PICK, success="final"), n_envs=2)["gymnasium_robotics"][0]
    wrapped.reset(seed=0)
    vector.reset(seed=[0, 1])
    for step, action in enumerate(actions[:-1]):
        wrapped.step(action)
        vector.step(np.stack([action, np.zeros(4)]))
        assert failure_of(wrapped) == expected[0][step]
        assert vector.call("failure") == (expected[0][step], expected[1][step])
    vector.close()
    wrapped.close()


def state(x=0.0, z=0.0, grip=1.0, opening=0.05):
    """A block at (x, 0, z) [m], the gripper ``grip`` above the table."""
    return {
        "object_pos": np.array([x, 0, z]),
        "grip_pos": np.array([x, 0, grip]),
        "gripper_state": np.full(2, opening / 2),
    }


@pytest.mark.parametrize(
    ("episode", "label"),
    [
        ([state(x=0.5 * MOVED)], "no contact"),
        ([state(grip=0.03, opening=0.1)], "missed grasp"),
        ([state(grip=0.06, opening=0.0)], "no contact"),
        ([state(x=0.1), state(x=0.1)], "missed grasp"),
        ([state(z=1.5 * LIFTED)], "missed grasp"),  # knocked up, not held
        ([state(z=0.5 * LIFTED, grip=0.01), state(opening=0.1)], "missed grasp"),  # held, not lifted
        ([state(z=1.5 * LIFTED, grip=1.5 * LIFTED), state(x=0.1)], "dropped"),
        ([state(z=1.5 * LIFTED, grip=1.5 * LIFTED)], "missed the goal"),
        ([state(z=0.1, grip=0.1, opening=0.0)], "missed grasp"),
    ],
)
def test_what_was_reached_held_and_lifted(episode, label):
    progress = Progress(PICK, state())
    for each in episode:
        progress.update(each, at_goal=False)
    assert progress.failure == label


def test_fingers_that_cannot_grasp_reach_by_moving_alone():
    progress = Progress(PUSH, state())
    progress.update(state(grip=0.03), at_goal=False)
    assert progress.failure == "no contact"


@pytest.mark.parametrize("task", [name for name in TASKS if name not in FAILURES])
def test_others_cannot_tell(make, task):
    env = make(task)
    env.reset(seed=0)
    assert not hasattr(env, "failure")
    assert failure_of(env) is None


def test_nothing_is_told_before_the_first_episode(make):
    assert failure_of(make(PUSH)) is None


def test_the_guide_lists_all_of_them_in_order():
    guide = (Path(__file__).parents[3] / "docs/guides/robotics.md").read_text()
    assert (
        tuple(re.findall(r"`([a-z ]+)` \|", guide.split("## Failures")[1].split("## ")[0])[1:])
        == FAILURES[PICK]
    )
