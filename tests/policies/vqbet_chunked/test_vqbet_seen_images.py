"""Images that every window needs are encoded as they come, and never twice."""

import pytest
import torch
from policy_cases import STATE, TOP, WRIST, A, B, Case

from lerobot_act_chunking.policies.vqbet_chunked.modeling_vqbet_chunked import VqbetChunkedPolicy

CASE = Case("cameras", "vqbet_chunked", STATE | TOP | WRIST, {"tokenizer": "dct", "use_ema": False})
OFTEN = {"n_obs_steps": 3, "execution": "crossfade", "replan_interval": 2}


def make(**settings):
    policy = CASE.policy(**OFTEN, **settings)
    generator = torch.Generator().manual_seed(2)
    for parameter in policy.parameters():
        parameter.data += 0.3 * torch.randn(parameter.shape, generator=generator)
    return policy


def rollout(policy, n_steps, after=lambda step: None):
    generator, actions = torch.Generator().manual_seed(3), []
    for step in range(n_steps):
        batch = {
            key: torch.randn(B, *feature.shape, generator=generator) for key, feature in CASE.inputs.items()
        }
        before = {key: value.clone() for key, value in batch.items()}
        actions.append(policy.select_action(batch))
        assert batch.keys() == before.keys()
        assert all(torch.equal(batch[key], before[key]) for key in batch)
        after(step)
    return torch.stack(actions)


def seen_late(monkeypatch):
    """Images are kept and encoded when a chunk is due."""
    monkeypatch.setattr(
        VqbetChunkedPolicy, "_encode_images_on_arrival", lambda self, observation: observation
    )


@pytest.mark.parametrize("use_ema", [False, True])
def test_the_same_actions_as_of_windows_encoded_at_once(monkeypatch, use_ema):
    policy = make(use_ema=use_ema)
    policy.reset(episode_seeds=range(B))
    actions = rollout(policy, 8)
    assert actions.std(0).min() > 1e-3
    seen_late(monkeypatch)
    policy.reset(episode_seeds=range(B))
    torch.testing.assert_close(rollout(policy, 8), actions, rtol=1e-4, atol=1e-5)


def test_an_environment_that_begins_anew_keeps_nothing(monkeypatch):
    def begin_anew(step):
        if step == 3:
            policy.reset(envs=[1], episode_seeds=[7])

    policy = make()
    policy.reset(episode_seeds=range(B))
    actions = rollout(policy, 8, begin_anew)
    seen_late(monkeypatch)
    policy.reset(episode_seeds=range(B))
    torch.testing.assert_close(rollout(policy, 8, begin_anew), actions, rtol=1e-4, atol=1e-5)


def test_averaged_weights_see():
    policy = make(use_ema=True)
    policy.reset(episode_seeds=range(B))
    actions = rollout(policy, 3)
    for parameter in policy.model.parameters():
        parameter.data.zero_()
    policy.reset(episode_seeds=range(B))
    assert torch.equal(rollout(policy, 3), actions)


def frames_encoded(policy, n_steps):
    """Of each camera, while acting."""
    counts = []
    backbone = policy.model.history.cameras.backbone
    handle = backbone.register_forward_pre_hook(lambda _, inputs: counts.append(len(inputs[0])))
    rollout(policy, n_steps)
    handle.remove()
    return sum(counts) / 2 / B


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"replan_interval": 1}, 8),
        ({"replan_interval": 3}, 8),
        ({"replan_interval": 4}, 2 * 3),  # of two windows; frames between them are not needed
        ({"replan_interval": 1, "n_obs_steps": 1}, 8),
        ({"replan_interval": 4, "n_obs_steps": 1}, 2),
    ],
    ids=lambda value: ",".join(map(str, value.values())) if isinstance(value, dict) else "",
)
def test_a_frame_is_encoded_once_and_only_if_it_is_needed(settings, expected):
    policy = CASE.policy(**{**OFTEN, **settings})
    assert frames_encoded(policy, 8) == expected


def test_single_observations_and_their_window_give_the_same_chunk():
    policy = make()
    steps = [{key: torch.randn(B, *feature.shape) for key, feature in CASE.inputs.items()} for _ in range(3)]
    noise = torch.rand(B, policy.tokenizer.n_codes)
    for step in steps:
        chunk = policy.predict_action_chunk(step, noise=noise)
    window = {key: torch.stack([step[key] for step in steps], dim=1) for key in steps[0]}
    assert chunk.shape[-1] == A
    torch.testing.assert_close(policy.predict_action_chunk(window, noise=noise), chunk, rtol=1e-4, atol=1e-5)
