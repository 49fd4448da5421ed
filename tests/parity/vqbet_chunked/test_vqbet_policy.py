"""With LeRobot's weights `vqbet_chunked` is LeRobot's ``vqbet``: codes, losses, gradients, chunks, actions.

Chunks are never padded here: LeRobot learns from padding, `vqbet_chunked` does not.
"""

from dataclasses import fields

import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.vqbet.configuration_vqbet import VQBeTConfig
from lerobot.policies.vqbet.modeling_vqbet import VQBeTPolicy
from test_vqbet_parts import shaken
from torch.func import functional_call
from vqbet_weights import convert

from lerobot_act_chunking.policies.vqbet_chunked.configuration_vqbet_chunked import VqbetChunkedConfig
from lerobot_act_chunking.policies.vqbet_chunked.modeling_vqbet_chunked import VqbetChunkedPolicy
from lerobot_act_chunking.sampling.held_draws import HeldDraws

B, C, A, S, G, M = 2, 5, 4, 6, 2, 8
IMAGE, STATE = "observation.image", "observation.state"
SHAPE = (3, 64, 64)
SETTINGS = {
    "vqvae_n_embed": M,
    "vqvae_embedding_dim": 12,
    "vqvae_enc_hidden_dim": 10,
    "gpt_hidden_dim": 32,
    "gpt_n_layer": 2,
    "gpt_n_head": 4,
    "dropout": 0.0,
    "spatial_softmax_num_keypoints": 7,
    "pretrained_backbone_weights": None,
    "offset_loss_weight": 30.0,
}


def pair(n_obs_steps=3, n_action_pred_token=2, **ours):
    """The two policies with the same weights, past the training of their tokenizer."""
    features = {
        "input_features": {
            IMAGE: PolicyFeature(FeatureType.VISUAL, SHAPE),
            STATE: PolicyFeature(FeatureType.STATE, (S,)),
        },
        "output_features": {"action": PolicyFeature(FeatureType.ACTION, (A,))},
        "n_obs_steps": n_obs_steps,
        "n_action_pred_token": n_action_pred_token,
        "device": "cpu",
        "push_to_hub": False,
    }
    widths = {"gpt_input_dim": 24, "gpt_output_dim": 20, "gpt_block_size": 40}
    torch.manual_seed(0)
    theirs = VQBeTConfig(**features, **SETTINGS, **widths, action_chunk_size=C, crop_shape=None)
    theirs = shaken(VQBeTPolicy(theirs)).eval()
    spread_codes(theirs.vqbet.action_head.vqvae_model)
    ours = VqbetChunkedConfig(preset="paper", **features, **SETTINGS, **ours, chunk_size=C)
    ours = VqbetChunkedPolicy(ours).eval()
    ours.tokenizer_phase.n_learned.fill_(ours.tokenizer_phase.n_steps)
    incompatible = ours.load_state_dict(converted(theirs.state_dict(), ours), strict=False)
    assert not incompatible.unexpected_keys
    assert all(key.startswith("tokenizer_phase.") for key in incompatible.missing_keys)
    return theirs, ours


def spread_codes(tokenizer):
    """As after training: frozen codes amid what the encoder says, the second level's on the first's rest."""
    tokenizer.discretized.fill_(True)
    tokenizer.vq_layer.freeze_codebook.fill_(True)
    with torch.no_grad():
        encodings = tokenizer.encoder(2 * torch.randn(2 * M, C * A))
    for level, rest in zip(
        tokenizer.vq_layer.layers, (encodings[:M], encodings[M:] - encodings[:M]), strict=True
    ):
        level._codebook.embed.copy_(rest[None])


def converted(theirs, ours):
    return convert(theirs, n_tokens=len(ours.model.gpt.positions))


def observations(n_steps):
    generator = torch.Generator().manual_seed(1)
    return [
        {
            IMAGE: torch.rand(B, *SHAPE, generator=generator),
            STATE: torch.randn(B, S, generator=generator),
        }
        for _ in range(n_steps)
    ]


def training_batch(policy):
    config = policy.config
    steps = observations(config.n_obs_steps)
    n_actions = len(config.action_delta_indices)
    return {
        **{key: torch.stack([step[key] for step in steps], dim=1) for key in steps[0]},
        "action": 2 * torch.randn(B, n_actions, A, generator=torch.Generator().manual_seed(2)),
        "action_is_pad": torch.zeros(B, n_actions, dtype=torch.bool),
    }


def take_likeliest(monkeypatch):
    monkeypatch.setattr(torch, "multinomial", lambda p, num_samples: p.argmax(-1, keepdim=True))


def draw_with(monkeypatch, numbers):
    """LeRobot's policy samples by these uniform numbers, one for each row of its probabilities."""

    def by_inverse_transform(probabilities, num_samples):
        return (probabilities.cumsum(-1) <= numbers.flatten()[:, None]).sum(-1, keepdim=True).clamp(max=M - 1)

    monkeypatch.setattr(torch, "multinomial", by_inverse_transform)


def test_the_same_actions_are_learned_from():
    theirs, ours = pair()
    assert ours.config.observation_delta_indices == theirs.config.observation_delta_indices
    assert ours.config.action_delta_indices == theirs.config.action_delta_indices
    assert ours.windows.tolist() == theirs.vqbet.select_target_actions_indices.tolist()


def test_the_same_codes_and_chunks_of_them():
    theirs, ours = pair()
    chunks = 2 * torch.randn(200, C, A)
    tokenizer = theirs.vqbet.action_head.vqvae_model
    codes = tokenizer.get_code(chunks)[1]
    assert torch.equal(ours.tokenizer.encode(chunks), codes)
    assert (codes.unique(dim=0).shape[0]) > M
    expected = tokenizer.get_action_from_latent(tokenizer.get_embeddings_from_code(codes))
    torch.testing.assert_close(ours.tokenizer.decode(codes), expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("sizes", [(3, 2), (1, 1), (1, 3), (4, 1)], ids=str)
def test_the_same_loss_and_gradients(monkeypatch, sizes):
    theirs, ours = pair(*sizes, bet_softmax_temperature=0.0)
    take_likeliest(monkeypatch)
    batch = training_batch(ours)
    loss, terms = theirs.forward(dict(batch))
    loss.backward()
    expected = {name: p.grad for name, p in theirs.named_parameters() if p.grad is not None}
    theirs.zero_grad()
    weights = dict(theirs.state_dict()) | dict(theirs.named_parameters())
    our_loss, metrics = functional_call(ours, converted(weights, ours), (batch,))
    our_loss.backward()
    assert our_loss.item() == pytest.approx(loss.item(), rel=1e-5)
    assert metrics["code_loss"] == pytest.approx(terms["classification_loss"], rel=1e-5)
    assert metrics["offset_loss"] == pytest.approx(terms["offset_loss"], rel=1e-5)
    actual = {name: p.grad for name, p in theirs.named_parameters() if p.grad is not None}
    assert actual.keys() == expected.keys()
    total = torch.stack([gradient.norm() for gradient in expected.values()]).norm()
    for name, gradient in expected.items():  # one is zero but for rounding: of the bias before a softmax
        assert (actual[name] - gradient).norm() <= 1e-4 * gradient.norm() + 1e-6 * total, name


@pytest.mark.parametrize("temperature", [0.1, 1.0])
def test_the_same_chunk_from_the_same_numbers(monkeypatch, temperature):
    theirs, ours = pair(bet_softmax_temperature=temperature)
    theirs.config.bet_softmax_temperature = temperature
    n_queries = len(ours.windows)
    batch = training_batch(ours)
    window = {key: batch[key] for key in (IMAGE, STATE)}
    their_window = {"observation.images": window[IMAGE][:, :, None], STATE: window[STATE]}
    chunks = []
    for seed in range(5):
        numbers = torch.rand(B, n_queries, G, generator=torch.Generator().manual_seed(seed))
        draw_with(monkeypatch, numbers)
        with torch.no_grad():
            expected = theirs.vqbet(their_window, rollout=True)
        chunks.append(ours.predict_action_chunk(window, noise=numbers[:, ours.config.n_obs_steps - 1]))
        torch.testing.assert_close(chunks[-1], expected, rtol=1e-4, atol=1e-5)
    assert any((chunk - chunks[0]).abs().max() > 0.1 for chunk in chunks[1:])


def test_the_same_actions_over_a_rollout(monkeypatch):
    theirs, ours = pair()
    numbers = torch.rand(B, len(ours.windows), G, generator=torch.Generator().manual_seed(3))
    draw_with(monkeypatch, numbers)
    current = numbers[None, :, ours.config.n_obs_steps - 1]
    monkeypatch.setattr(HeldDraws, "draw", lambda *_, **__: current)
    for observation in observations(2 * C + 2):
        expected = theirs.select_action(dict(observation))
        torch.testing.assert_close(ours.select_action(observation), expected, rtol=1e-4, atol=1e-5)


DIFFERENT = {
    "action_chunk_size": "chunk_size, below",
    "normalization_mapping": "ours also has environment states, below",
    "crop_shape": "no preset crops: LeRobot's 84 x 84 is made for images of 96 x 96",
    "pretrained_backbone_weights": "never downloaded: given, or none",
    "use_group_norm": "backbone_norm",
    "gpt_block_size": "follows from the tokens that there are",
    "gpt_input_dim": "the linear map behind it is folded",
    "gpt_output_dim": "the linear map before it is folded",
    "optimizer_eps": "AdamW's default, the same",
    "scheduler_warmup_steps": "lr_warmup_steps, below",
}


def test_the_paper_preset_is_lerobots_default():
    features = {
        "input_features": {STATE: PolicyFeature(FeatureType.STATE, (S,))},
        "output_features": {"action": PolicyFeature(FeatureType.ACTION, (A,))},
        "device": "cpu",
    }
    theirs, ours = VQBeTConfig(**features), VqbetChunkedConfig(preset="paper", **features)
    missing = object()
    different = {
        field.name
        for field in fields(theirs)
        if getattr(ours, field.name, missing) != getattr(theirs, field.name)
    }
    assert different == DIFFERENT.keys()
    assert ours.chunk_size == ours.n_action_steps == theirs.action_chunk_size
    assert ours.normalization_mapping.items() >= theirs.normalization_mapping.items()
    assert ours.lr_warmup_steps == theirs.scheduler_warmup_steps
    assert ours.execution == "open_loop"
