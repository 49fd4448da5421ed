"""A push in simulation, and what is made of the answers to it."""

import dataclasses

import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from policy_cases import MODULES
from tiers import full_tier

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.diagnostics.bandwidth import push as push_module
from lerobot_act_chunking.diagnostics.bandwidth.measuring import measure
from lerobot_act_chunking.diagnostics.bandwidth.push import (
    apply_execution,
    compare,
    executions,
    load_for_execution,
    push_object,
    study_push,
)
from lerobot_act_chunking.diagnostics.bandwidth.push_plot import plot_push
from lerobot_act_chunking.diagnostics.bandwidth.settings import Limits
from lerobot_act_chunking.diagnostics.bandwidth.source import read_source
from lerobot_act_chunking.diagnostics.core.environments import environment_of
from lerobot_act_chunking.diagnostics.core.rollouts import Inference, Rollout
from lerobot_act_chunking.envs.aloha.env import AlohaSimEnv
from lerobot_act_chunking.errors import ConfigurationError

CHUNK, JOINTS, STEPS, PUSH_STEP = 12, 14, 40, 17
SMALL = {"dim_model": 16, "n_heads": 2, "dim_feedforward": 24, "n_encoder_layers": 1, "use_vae": False}
INPUTS = {
    "observation.state": PolicyFeature(FeatureType.STATE, (JOINTS,)),
    "observation.environment_state": PolicyFeature(FeatureType.ENV, (7,)),
}
START = torch.tensor([0.0, -0.96, 1.16, 0.0, -0.3, 0.0, 0.5] * 2)


def checkpoint(folder, type_="act_chunked", **settings):
    """An untrained policy that follows the object, hardly its joints, with one opinion for all steps."""
    needed = {"act_chunked": "act_chunked", "act": "temporal_ensemble"}[type_]  # which wraps it
    if needed not in MODULES:
        pytest.skip(f"there is no {needed}")
    if type_ == "act_chunked":
        settings = {"actions_per_query": 1, **settings}
    config = PreTrainedConfig.get_choice_class(type_)(
        device="cpu",
        push_to_hub=False,
        chunk_size=CHUNK,
        dropout=0.0,
        input_features=dict(INPUTS),
        output_features={"action": PolicyFeature(FeatureType.ACTION, (JOINTS,))},
        normalization_mapping=dict.fromkeys(("STATE", "ENV", "ACTION", "VISUAL"), "MEAN_STD"),
        **{**SMALL, **settings},
    )
    torch.manual_seed(0)
    policy = get_policy_class(type_)(config)
    queries = [parameter for parameter in policy.parameters() if len(parameter) == CHUNK]
    for query in queries:
        query.data[:] = query.data[0].clone()
    stats = {
        "observation.state": {"mean": START, "std": torch.full((JOINTS,), 100.0)},
        "observation.environment_state": {"mean": torch.zeros(7), "std": torch.full((7,), 0.05)},
        "action": {"mean": START, "std": torch.full((JOINTS,), 0.02)},
    }
    policy.save_pretrained(folder)
    for processor in make_pre_post_processors(config, dataset_stats=stats):
        processor.save_pretrained(folder)
    return str(folder)


@pytest.fixture
def short_episodes(monkeypatch):
    def short(*asked):
        return dataclasses.replace(environment_of(*asked), episode_length=STEPS)

    monkeypatch.setattr(push_module, "environment_of", short)


def study(path, task="transfer_cube", push_step=PUSH_STEP, episodes=2, **overrides):
    source = read_source(path, overrides)
    return study_push(source, task=task, push_m=0.05, push_step=push_step, episodes=episodes, seed=1000)


@pytest.mark.usefixtures("short_episodes")
@pytest.mark.parametrize(("type_", "own"), [("act_chunked", {"execution": "open_loop"}), ("act", {})])
def test_a_policy_answers_as_the_formula_says(type_, own, tmp_path):
    path = checkpoint(tmp_path, type_, n_action_steps=6, **own)
    result = study(path, n_action_steps=CHUNK, replan_interval=1, temporal_ensemble_coeff=0.05)
    open_loop, newest, ensemble = result.responses
    assert [r.settings.execution for r in result.responses] == ["open_loop", "receding", "ensemble"]
    assert open_loop.settle_90_steps == open_loop.expected_settle_90_steps == 0  # step 18 is a replan
    assert newest.settle_90_steps == newest.expected_settle_90_steps == 0
    assert ensemble.settle_90_steps == ensemble.expected_settle_90_steps == 11
    np.testing.assert_allclose(ensemble.shares, ensemble.expected, atol=0.02)
    assert min(ensemble.demanded) > 1e-4
    assert result.seeds == [1000, 1001]
    assert ensemble.successes == ensemble.undisturbed_successes == 0


@full_tier
@pytest.mark.usefixtures("short_episodes")
def test_is_reproducible_reported_and_drawn(tmp_path):
    path = checkpoint(tmp_path / "checkpoint")
    first, second = (study(path, execution="receding", replan_interval=5, episodes=1) for _ in range(2))
    assert first == second
    report = measure(read_source(path, {}), 50.0, Limits(), first)
    content = report.to_json()["push"]
    assert content["task"] == "transfer_cube"
    assert [r["settings"]["execution"] for r in content["responses"]][-1] == "ensemble"
    assert plot_push(first, tmp_path / "push.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(("task", "n_objects"), [("transfer_cube", 1), ("insertion", 2)])
def test_the_push_moves_the_first_object_once_and_nothing_else(task, n_objects):
    env = AlohaSimEnv(task=task)
    env.reset(seed=3)
    before, joints = env.world.environment_state(), env.world.qpos()
    push = push_object(4, 0.03)
    push(3, 3, env)
    np.testing.assert_array_equal(env.world.environment_state(), before)
    push(3, 4, env)
    moved = env.world.environment_state() - before
    assert moved[0] == pytest.approx(0.03)
    assert len(moved) == 7 * n_objects
    assert not moved[1:].any()
    np.testing.assert_array_equal(env.world.qpos(), joints)
    observation, *_ = env.step(START.numpy())
    assert observation["environment_state"][0] == pytest.approx(before[0] + 0.03, abs=2e-3)


def rollout(commands, chunk_of, interval, success=False):
    commands = np.asarray(commands, dtype=float)
    T = len(commands)
    inferences = tuple(Inference(s, np.full((20, JOINTS), chunk_of(s))) for s in range(0, T, interval))
    return Rollout(
        0,
        0.02,
        np.repeat(commands[:, None], JOINTS, 1),
        np.zeros((T, JOINTS)),
        np.zeros(T),
        success,
        inferences,
    )


def test_shares_are_commanded_over_demanded():
    settings = ExecutionSettings(4, "ensemble", replan_interval=1, ensemble_weighting="uniform")
    event, T = 5, 20
    demand = 2.0
    answer = [0.0] * event + [0.5, 1.0, 1.5] + [2.0] * (T - event - 3)
    quiet = rollout([0.0] * T, lambda s: 0.0, 1, success=True)
    pushed = rollout(answer, lambda s: demand * (s >= event), 1)
    response = compare(settings, [quiet], [pushed], event)
    assert response.shares == pytest.approx([0.25, 0.5, 0.75, 1.0, 1.0])
    assert response.expected == pytest.approx([0.25, 0.5, 0.75, 1.0, 1.0])
    assert response.settle_90_steps == response.expected_settle_90_steps == 3
    assert response.commanded == pytest.approx([0.5, 1.0, 1.5, 2.0, 2.0])
    assert response.demanded == pytest.approx([2.0] * 5)
    assert (response.successes, response.undisturbed_successes) == (0, 1)


def test_dead_time_has_no_share_and_episodes_that_end_are_left_out():
    settings = ExecutionSettings(6, "receding", replan_interval=5)
    event = 7  # the next inference is at 10
    quiet = [rollout([0.0] * n, lambda s: 0.0, 5) for n in (12, 30)]
    pushed = [rollout([1.0 * (t >= 10) for t in range(30)], lambda s: 1.0 * (s >= event), 5)] * 2
    response = compare(settings, quiet, pushed, event)
    assert response.shares == pytest.approx([0, 0, 0] + [1] * 8)
    assert response.expected == response.shares
    assert response.settle_90_steps == 3


def test_an_answer_that_never_comes():
    settings = ExecutionSettings(4, "receding", replan_interval=1)
    quiet = rollout([0.0] * 9, lambda s: 0.0, 1)
    pushed = rollout([0.0] * 9, lambda s: 1.0 * (s >= 5), 1)
    assert compare(settings, [quiet], [pushed], 5).settle_90_steps is None


def test_compares_with_and_without_averaging():
    own = ExecutionSettings(20, "open_loop", 10)
    asked = ExecutionSettings(20, "ensemble", 20, 4)
    newest = ExecutionSettings(20, "receding", 20, 4)
    assert executions(own, asked) == [own, newest, asked]
    assert executions(asked, asked) == [asked, newest]
    smoothed = ExecutionSettings(20, "ensemble", 20, 4, smoothing_steps=3)
    assert executions(smoothed, smoothed)[1] == ExecutionSettings(20, "receding", 20, 4, smoothing_steps=3)
    averaging = ExecutionSettings(20, "ensemble", 10)
    assert executions(own, own) == [own, ExecutionSettings(20, "receding", 10, 2), averaging]


def test_the_execution_of_a_loaded_policy_can_be_changed(tmp_path):
    policy = load_for_execution(checkpoint(tmp_path))
    settings = ExecutionSettings(CHUNK, "ensemble", 9, 2, ensemble_weighting="recency", gripper_dims=(6,))
    apply_execution(policy, settings)
    policy.policy.reset()
    assert policy.policy._action_queue.settings == settings


def test_refusals(tmp_path):
    path = checkpoint(tmp_path)
    with pytest.raises(ConfigurationError, match="give a checkpoint before --env"):
        study(None)
    with pytest.raises(
        ConfigurationError, match="unknown task to push in 'pouring'; choose one of: transfer_cube"
    ):
        study(path, task="pouring")
    with pytest.raises(ConfigurationError, match="push_step=399 is outside the episode: 0 to 398"):
        study(path, push_step=399)
    with pytest.raises(ConfigurationError, match="episodes=0 must be a positive number"):
        study(path, episodes=0)
    with pytest.raises(ConfigurationError, match="n_action_steps=30 exceeds the 12 control steps"):
        study(path, chunk_size=30, replan_interval=1, temporal_ensemble_coeff=0.01, n_action_steps=30)
