"""act_chunked with several observations: acting and training see the same windows."""

import pytest
import torch
from policy_cases import ENVIRONMENT, STATE, TOP, VELOCITY, WRIST, B, Case, history_batch

H, STRIDE = 3, 2
HISTORY = {"n_obs_steps": H, "obs_stride": STRIDE, "use_vae": False}
CASES = {
    "vectors": Case(
        "vectors", "act_chunked", STATE | VELOCITY | ENVIRONMENT, HISTORY | {"use_velocity": True}
    ),
    "cameras": Case("cameras", "act_chunked", STATE | TOP | WRIST, HISTORY | {"history_image_grid": 2}),
}
EVERY_STEP = {"execution": "open_loop", "n_action_steps": 1}


def make(case, **settings):
    """A policy whose steps and cameras differ, as learned ones do."""
    policy = case.policy(**settings)
    generator = torch.Generator().manual_seed(2)
    for parameter in policy.parameters():
        parameter.data += 0.3 * torch.randn(parameter.shape, generator=generator)
    return policy.eval()


def frames(case, n_steps):
    generator = torch.Generator().manual_seed(3)
    return [
        {key: torch.randn(B, *feature.shape, generator=generator) for key, feature in case.inputs.items()}
        for _ in range(n_steps)
    ]


def window(steps, now, started):
    """What training would see at step ``now``; each environment's episode started at a step of its own."""
    places = [[max(start, now - age * STRIDE) for age in (2, 1, 0)] for start in started]
    return {
        key: torch.stack([torch.stack([steps[t][key][env] for t in at]) for env, at in enumerate(places)])
        for key in steps[0]
    }


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_every_action_is_that_of_its_window(case):
    policy, steps, started = make(case, **EVERY_STEP), frames(case, 9), [0] * B
    actions = []
    for now, step in enumerate(steps):
        if now == 6:
            policy.reset(envs=[1])
            started[1] = now
        actions.append(policy.select_action(step))
        expected = policy.predict_action_chunk(window(steps, now, started))[:, 0]
        torch.testing.assert_close(actions[-1], expected, rtol=1e-4, atol=1e-5)
    assert torch.stack(actions).std(0).min() > 1e-3


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_every_step_of_the_window_matters(case):
    policy, batch = make(case), history_batch(make(case))
    chunk = policy.predict_action_chunk(batch)
    for key in case.inputs:
        for step in range(H):
            changed = batch[key].clone()
            changed[:, step] += 1
            assert not torch.allclose(policy.predict_action_chunk(batch | {key: changed}), chunk, atol=1e-4)


def test_history_dropout_is_for_training_alone():
    """Almost always on, so that every sample forgets."""
    policy = make(CASES["vectors"], history_dropout=1 - 1e-7)
    batch = history_batch(policy)
    other = {key: value.clone() for key, value in batch.items()}
    for key in CASES["vectors"].inputs:
        other[key][:, :-1] += 1

    def loss(inputs):
        return policy.forward(inputs)[0].item()

    assert loss(batch) != loss(other)
    policy.train()
    assert loss(batch) == loss(other)


def test_velocities_have_the_scale_of_training_when_acting(tmp_path):
    policy = make(CASES["vectors"], use_ema=True)
    initial = policy.model.observation_encoder.differences.scale
    batch = history_batch(policy)
    policy.train()
    policy.forward(batch)[0].backward()
    policy.update()
    policy.save_pretrained(tmp_path)
    for each in (policy, type(policy).from_pretrained(tmp_path)):
        acting = each.eval()._network.observation_encoder.differences
        assert not torch.equal(acting.scale, initial)
        assert torch.equal(acting.scale, policy.model.observation_encoder.differences.scale)
        assert acting.n_batches == 1


@pytest.mark.parametrize("use_ema", [False, True])
def test_features_that_were_kept_give_the_same_actions(monkeypatch, use_ema):
    """Images are encoded when they come, or all of a window's when a chunk is due."""
    policy = make(CASES["cameras"], use_ema=use_ema, execution="crossfade", replan_interval=2)
    steps = frames(CASES["cameras"], 8)
    kept = [policy.select_action(step) for step in steps]
    monkeypatch.setattr(type(policy), "_encode_images_on_arrival", lambda self, observation: observation)
    policy.reset()
    late = [policy.select_action(step) for step in steps]
    torch.testing.assert_close(kept, late, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(("replan_interval", "n_encoded"), [(1, 8), (3, 8), (4, 2 * H)])
def test_a_frame_is_encoded_once_and_only_if_it_is_needed(replan_interval, n_encoded):
    """Of each camera, in 8 steps: each frame, or those of two windows alone."""
    policy = make(CASES["cameras"], execution="crossfade", replan_interval=replan_interval)
    counts = []
    backbone = policy.model.observation_encoder.cameras.backbone
    backbone.register_forward_pre_hook(lambda _, inputs: counts.append(len(inputs[0])))
    for step in frames(CASES["cameras"], 8):
        policy.select_action(step)
    assert sum(counts) / 2 / B == n_encoded


def test_the_style_encoder_reads_the_newest_state():
    """A latent belongs to the moment that the chunk starts at, however long the history."""
    case = Case("vae", "act_chunked", STATE, HISTORY | {"use_vae": True})
    policy = make(case)
    batch = history_batch(policy)
    state = batch["observation.state"]
    training_batch = policy._training_batch(batch, None)
    assert torch.equal(training_batch.state, state[:, -1])
    assert not torch.equal(state[:, -1], state[:, 0])
