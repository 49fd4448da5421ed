"""Rollouts are lerobot-eval's episodes, with everything written down."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.scripts.lerobot_eval import rollout as lerobot_rollout
from policy_cases import MODULES
from small_policies import CAMERA, CHUNK, JOINTS, OURS, START, make_policy

from lerobot_act_chunking.diagnostics.core.environments import environment_of, task_environment
from lerobot_act_chunking.diagnostics.core.rollouts import roll_out
from lerobot_act_chunking.envs.aloha.tasks import sample_object_pose, stock_generator
from lerobot_act_chunking.envs.configuration_envs import AlohaSimEnvConfig
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.loading import LoadedPolicy

STEPS = 23
SEEDS = (1003, 1000, 1007)


def short(**options) -> AlohaSimEnvConfig:
    return AlohaSimEnvConfig(task="transfer_cube", episode_length=STEPS, **{"obs_type": "state", **options})


def by_lerobot(policy: LoadedPolicy, env_config: AlohaSimEnvConfig, seeds) -> dict[str, np.ndarray]:
    env = next(iter(env_config.create_envs(len(seeds)).values()))[0]
    try:
        result = lerobot_rollout(
            env,
            policy.policy,
            *env_config.get_env_processors(),
            policy.preprocessor,
            policy.postprocessor,
            seeds=list(seeds),
        )
    finally:
        env.close()
    return {key: value.numpy() for key, value in result.items()}


@pytest.mark.parametrize(
    ("type_", "settings"),
    [
        (OURS, {"n_action_steps": 5}),
        (OURS, {"execution": "ensemble", "replan_interval": 3, "temporal_ensemble_coeff": 0.1}),
        ("act", {"n_action_steps": 5, "dropout": 0.0}),
    ],
)
def test_commands_and_rewards_are_those_of_lerobot_eval(type_, settings):
    policy = make_policy(type_, **settings)
    theirs = by_lerobot(policy, short(), SEEDS)
    ours = roll_out(policy, short(), SEEDS)
    assert [rollout.seed for rollout in ours] == list(SEEDS)
    for i, rollout in enumerate(ours):
        np.testing.assert_array_equal(rollout.commands, theirs["action"][i])
        np.testing.assert_array_equal(rollout.rewards, theirs["reward"][i])
        assert rollout.success == theirs["success"][i].any()
        assert rollout.dt == 0.02


@pytest.mark.parametrize(("velocities", "sizes"), [(True, (10, 18)), (False, (5, 12))])
def test_robotics_worlds_are_rolled_out_as_by_lerobot_eval(velocities, sizes):
    inputs = {
        "observation.state": PolicyFeature(FeatureType.STATE, sizes[:1]),
        "observation.environment_state": PolicyFeature(FeatureType.ENV, sizes[1:]),
    }
    policy = make_policy(inputs=inputs, start=torch.tensor([0.5, -0.3, 0.2, 0.0]), n_action_steps=5)
    config = environment_of(policy.policy.config, task_environment("FetchPush-v4", "final"))
    assert config.velocities is velocities
    config = replace(config, episode_length=6)
    theirs = by_lerobot(policy, config, SEEDS)
    for i, rollout in enumerate(roll_out(policy, config, SEEDS)):
        np.testing.assert_array_equal(rollout.commands, theirs["action"][i])
        np.testing.assert_array_equal(rollout.rewards, theirs["reward"][i])
        assert (rollout.positions.shape, rollout.dt) == ((6, 0), 0.04)


def test_images_reach_the_policy_as_in_lerobot_eval():
    policy = make_policy(inputs=CAMERA, vision_backbone="small_cnn")
    env_config = short(
        obs_type="pixels", cameras=["top"], observation_height=48, observation_width=64, render_quality="fast"
    )
    env_config.episode_length = 9  # one chunk and the next one's first step
    theirs = by_lerobot(policy, env_config, SEEDS[:2])
    ours = roll_out(policy, env_config, SEEDS[:2])
    np.testing.assert_array_equal([rollout.commands for rollout in ours], theirs["action"])
    assert not np.array_equal(ours[0].commands[8], ours[1].commands[8])


def test_positions_are_those_before_each_command():
    seen = []
    (rollout,) = roll_out(
        make_policy(),
        short(),
        [1000],
        on_step=lambda seed, step, env: seen.append((seed, step, env.unwrapped.world.qpos())),
    )
    assert [(seed, step) for seed, step, _ in seen] == [(1000, step) for step in range(STEPS)]
    np.testing.assert_array_equal(rollout.positions, [qpos for *_, qpos in seen])
    np.testing.assert_allclose(rollout.positions[0, :6], START[:6], atol=1e-6)
    assert np.abs(rollout.positions[1] - rollout.positions[0]).max() > 1e-4


def test_chunks_are_in_the_units_of_the_commands():
    rollouts = roll_out(make_policy(n_action_steps=5), short(), SEEDS, n_envs=2)
    for rollout in rollouts:
        assert [inference.step for inference in rollout.inferences] == [0, 5, 10, 15, 20]
        for inference in rollout.inferences:
            executed = rollout.commands[inference.step : inference.step + 5]
            assert inference.chunk.shape == (5, JOINTS)
            np.testing.assert_array_equal(inference.chunk[: len(executed)], executed)


def test_chunks_of_lerobots_own_policies_are_seen_too():
    policy = make_policy("act", n_action_steps=5, dropout=0.0)
    (rollout,) = roll_out(policy, short(), [1000])
    assert [inference.step for inference in rollout.inferences] == [0, 5, 10, 15, 20]
    assert rollout.inferences[1].chunk.shape == (CHUNK, JOINTS)
    np.testing.assert_array_equal(rollout.inferences[1].chunk[:5], rollout.commands[5:10])
    assert "predict_action_chunk" not in vars(policy.policy)


def test_unlogged_chunks_still_count_as_network_calls():
    (rollout,) = roll_out(make_policy(n_action_steps=5), short(), [1000], log_chunks=False)
    assert [inference.step for inference in rollout.inferences] == [0, 5, 10, 15, 20]
    assert all(inference.chunk.shape == (0, JOINTS) for inference in rollout.inferences)


def test_instruments_are_removed_and_the_next_rollout_is_the_same():
    policy = make_policy(execution="ensemble", replan_interval=2)
    first, second = (roll_out(policy, short(), SEEDS) for _ in range(2))
    assert policy.policy._action_queue.on_chunk is None
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.commands, other.commands)
        assert len(one.inferences) == len(other.inferences) == 12


def test_what_another_policy_draws_follows_from_the_seed_and_the_draw(monkeypatch):
    policy = make_policy("act", n_action_steps=5, dropout=0.0)
    chosen = policy.policy.select_action
    monkeypatch.setattr(policy.policy, "select_action", lambda batch: torch.rand_like(chosen(batch)))
    one, again, other = (roll_out(policy, short(), SEEDS, draw=draw)[0].commands for draw in (0, 0, 1))
    np.testing.assert_array_equal(one, again)
    assert not np.array_equal(one, other)


def test_no_chunk_is_computed_in_the_background():
    settings = {"execution": "receding", "replan_interval": 2}
    waits, one = (
        roll_out(make_policy(**settings, **more), short(), SEEDS) for more in ({}, {"background": True})
    )
    for expected, rollout in zip(waits, one, strict=True):
        np.testing.assert_array_equal(rollout.commands, expected.commands)


def test_a_success_ends_its_episode_and_leaves_the_others_alone(monkeypatch):
    """The environment of one seed succeeds at step 7; its batch goes on at the same size."""
    from lerobot_act_chunking.envs.aloha.env import AlohaSimEnv

    step = AlohaSimEnv.step
    lucky = sample_object_pose("transfer_cube", stock_generator(SEEDS[1]))
    counts = {}

    def succeed_at_7(self, action):
        observation, reward, _, truncated, info = step(self, action)
        counts[id(self)] = counts.get(id(self), 0) + 1
        cube = self.world.environment_state()[:2]
        success = counts[id(self)] == 7 and bool(np.allclose(cube, lucky[:2], atol=0.01))
        return observation, 4.0 if success else reward, success, truncated, {**info, "is_success": success}

    policy = make_policy(n_action_steps=5)
    untouched = roll_out(policy, short(), SEEDS)
    sizes = []
    select = policy.policy.select_action
    monkeypatch.setattr(
        policy.policy,
        "select_action",
        lambda batch: sizes.append(len(batch["observation.state"])) or select(batch),
    )
    monkeypatch.setattr(AlohaSimEnv, "step", succeed_at_7)
    rollouts = roll_out(policy, short(), SEEDS)
    assert [rollout.success for rollout in rollouts] == [False, True, False]
    assert [len(rollout.commands) for rollout in rollouts] == [STEPS, 7, STEPS]
    assert rollouts[1].rewards[-1] == 4.0
    assert [inference.step for inference in rollouts[1].inferences] == [0, 5]
    assert sorted(counts.values()) == [7, STEPS, STEPS]
    assert set(sizes) == {3}
    for one, other in zip(rollouts, untouched, strict=True):
        np.testing.assert_array_equal(one.commands, other.commands[: len(one.commands)])


def test_given_commands_come_first_and_the_policy_goes_on_from_there():
    policy = make_policy(n_action_steps=5)
    plain, _, other = roll_out(policy, short(), SEEDS)
    given = {plain.seed: plain.commands[:9] + 0.05}
    led, _, left_alone = roll_out(policy, short(), SEEDS, given=given)
    assert np.array_equal(led.commands[:9], given[plain.seed])
    assert not np.array_equal(led.commands[9:], plain.commands[9:])  # it has seen another state
    assert np.array_equal(left_alone.commands, other.commands)
    (same, *_) = roll_out(policy, short(), SEEDS, given={plain.seed: plain.commands[:9]})
    assert np.array_equal(same.commands, plain.commands)


def test_groups_of_environments_reuse_worlds_and_report_progress():
    finished = []
    policy = make_policy(n_action_steps=5)
    together = roll_out(policy, short(), SEEDS)
    grouped = roll_out(policy, short(), SEEDS, n_envs=2, progress=finished.append)
    for one, other in zip(grouped, together, strict=True):
        np.testing.assert_allclose(one.commands, other.commands, atol=1e-5)
    assert finished == sorted(finished)
    assert finished[-1] == 3
    assert 2 in finished


def test_what_a_policy_draws_follows_from_the_episodes_seed():
    """Whatever runs beside it or before it, and at any place in the batch."""
    drawing = {**MODULES[OURS].DRAWING, "n_action_steps": 5}
    policy = make_policy(**drawing)
    together = roll_out(policy, short(), SEEDS)
    other_way = roll_out(policy, short(), SEEDS[::-1], n_envs=2)[::-1]
    for one, other in zip(other_way, together, strict=True):
        np.testing.assert_allclose(one.commands, other.commands, atol=1e-5)
    otherwise = roll_out(make_policy(**drawing, noise_seed=1), short(), SEEDS)
    assert np.abs(otherwise[0].commands - together[0].commands).max() > 1e-3


@pytest.mark.parametrize(("seeds", "n_envs"), [((), 3), ((1000,), 0)])
def test_nothing_to_run_is_refused(seeds, n_envs):
    with pytest.raises(ConfigurationError, match=f"got {len(seeds)} and n_envs={n_envs}"):
        roll_out(make_policy(), short(), seeds, n_envs=n_envs)
