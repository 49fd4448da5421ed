"""The task in which the instruction decides."""

import numpy as np
import pytest
from tiers import full_tier

from lerobot_act_chunking.envs.aloha.env import AlohaSimEnv
from lerobot_act_chunking.envs.aloha.experts import ExpertOptions, plan
from lerobot_act_chunking.envs.aloha.failures import FAILURES, STEADY_STEPS, make_progress
from lerobot_act_chunking.envs.aloha.instructions import COLOURS, GOALS, INSTRUCTIONS, Goal, phrases
from lerobot_act_chunking.envs.aloha.options import AlohaSimOptions
from lerobot_act_chunking.envs.aloha.rewards import TABLE
from lerobot_act_chunking.envs.aloha.success import FINGERS, SUCCESS_RULES, make_reward, make_success_rule
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.recording.aloha import AlohaSource

TASK = "language_transfer"


@pytest.fixture(scope="module")
def env():
    return AlohaSimEnv(render_mode=None, task=TASK, success="hold")


def test_every_phrase_means_one_goal_and_held_out_ones_are_never_recorded():
    seen, unseen = (
        {phrase: goal for goal in GOALS for phrase in phrases(goal, kind)} for kind in ("seen", "unseen")
    )
    assert len(GOALS) == 6
    assert len(seen) == 6 * len(phrases(Goal(), "seen")) == 288
    assert len(unseen) == 6 * len(phrases(Goal(), "unseen")) == 144
    assert not seen.keys() & unseen.keys()
    for phrase, goal in (seen | unseen).items():
        assert [colour for colour in COLOURS if colour in phrase] == [goal.colour]
        assert goal.taker in phrase


def test_a_seed_is_one_scene_and_one_goal_in_different_words(env):
    found = {}
    for kind in INSTRUCTIONS:
        other = AlohaSimEnv(render_mode=None, task=TASK, instructions=kind)
        for seed in range(12):
            observation, _ = other.reset(seed=seed)
            found[kind, seed] = other.goal, other.task_description
            env.reset(seed=seed)
            assert (observation["environment_state"] == env.world.environment_state()).all()
            assert env.goal == other.goal
    goals = {seed: found["seen", seed][0] for seed in range(12)}
    assert len(set(goals.values())) > 3
    for kind in ("seen", "unseen"):
        assert all(found[kind, seed][1] in phrases(goal, kind) for seed, goal in goals.items())
    told = [found["shuffled", seed][1] in phrases(goal, "seen") for seed, goal in goals.items()]
    assert not all(told)


def test_cubes_lie_apart_where_both_arms_reach(env):
    poses = []
    for seed in range(30):
        env.reset(seed=seed)
        poses.append(env.world.environment_state().reshape(3, 7)[:, :2])
    poses = np.array(poses)
    assert np.abs(poses[..., 0]).max() <= 0.04
    assert np.diff(poses[..., 1], axis=1).min() >= 0.09


@pytest.mark.parametrize("goal", [Goal("green", "left"), Goal("blue", "right")], ids=["left", "right"])
def test_the_expert_hands_the_named_cube_to_the_named_arm(env, goal):
    env.reset(seed=3, options={"goal": goal})
    pose, rng = env.world.environment_state(), np.random.default_rng(0)
    wrong = [make_success_rule("hold", TASK, each) for each in GOALS if each != goal]
    for action in plan(TASK, pose, ExpertOptions(), rng, goal=goal).commands:
        info = env.step(action)[-1]
        for rule in wrong:
            rule.update(env.world.contacts())
    assert info["is_success"]
    assert not any(rule.succeeded for rule in wrong)
    assert env.failure is None


@full_tier
def test_the_expert_fails_rarely(env):
    failed = 0
    for seed in range(60):
        env.reset(seed=1000 + seed)
        rng = np.random.default_rng(seed)
        for action in plan(TASK, env.world.environment_state(), ExpertOptions(), rng, goal=env.goal).commands:
            info = env.step(action)[-1]
        failed += not info["is_success"]
    assert failed <= 1


@pytest.mark.parametrize("name", SUCCESS_RULES)
def test_success_asks_for_the_named_cube_from_one_hand_in_the_other(name):
    def held(colour, arm):
        return frozenset((f"{colour}_box", finger) for finger in FINGERS[arm])

    for goal in GOALS:
        reward, rule = make_reward(TASK, goal), make_success_rule(name, TASK, goal)
        for other in GOALS:
            assert (reward(held(other.colour, other.taker)) == 4) == (other == goal)
            rule.reset()
            for arm in (other.giver, other.taker):
                done = [rule.update(held(other.colour, arm)) for _ in range(10)][-1]
            assert done == (other == goal)
        assert reward(held(goal.colour, goal.taker) | {(goal.geom, TABLE)}) == 3
        rule.reset()
        assert not any(rule.update(held(goal.colour, goal.taker)) for _ in range(10))


def test_a_lifted_cube_that_was_not_named_is_the_wrong_one():
    assert "wrong cube" in FAILURES[TASK]
    progress = make_progress(TASK, Goal("blue", "right"))
    assert progress.failure == "no contact"
    lifted = frozenset(("red_box", finger) for finger in FINGERS["left"])
    for _ in range(STEADY_STEPS):
        progress.update(lifted, [0.1, 0.02, 0.02])
    assert progress.failure == "wrong cube"
    named = frozenset(("blue_box", finger) for finger in FINGERS["left"])
    for _ in range(STEADY_STEPS):
        progress.update(named, [0.02, 0.02, 0.1])
    assert progress.failure == "no hand-over"


def test_other_tasks_have_one_instruction():
    with pytest.raises(ConfigurationError, match="instructions=unseen is for language_transfer"):
        AlohaSimOptions(task="transfer_cube", instructions="unseen")
    with pytest.raises(ConfigurationError, match="unknown instructions 'french'"):
        AlohaSimOptions(task=TASK, instructions="french")


def test_recordings_keep_each_episodes_words_and_other_tasks_nothing_of_them():
    source = AlohaSource(AlohaSimOptions(task=TASK, success="hold"))
    assert source.settings["instructions"] == "seen"
    assert "instructions" not in AlohaSource(AlohaSimOptions()).settings
    with source.open() as play:
        episode = play(4)
    env = source.make_env()
    env.reset(seed=4)
    assert episode.success
    assert episode.task == env.task_description in phrases(env.goal, "seen")
    assert episode.arrays["observation.environment_state"].shape == (len(episode), 21)
