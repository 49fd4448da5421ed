import torch
import torch.nn.functional as F  # noqa: N812
from denoiser_cases import PATCH, A, B, D, N, T, answer, condition, dit, draw, shaken

from lerobot_act_chunking.nn.attention import Attention
from lerobot_act_chunking.nn.condition import Condition

HEADS = 2


def test_observation_tokens_are_a_set():
    denoiser = shaken(dit())
    observed, order = condition(), torch.randperm(N, generator=torch.Generator().manual_seed(0))
    x, time = draw(B, T, A), torch.full((B,), 0.3)
    torch.testing.assert_close(
        answer(denoiser, x, time, observed),
        answer(denoiser, x, time, Condition(tokens=observed.tokens[:, order])),
        rtol=1e-4,
        atol=1e-5,
    )


def test_the_observation_is_read_once_per_chunk():
    denoiser = shaken(dit())
    context = denoiser.observe(condition())
    assert [k.shape for k, _ in context.memory] == [(B, HEADS, N, D // HEADS)] * 2
    calls = []
    for block in denoiser.blocks:
        block.cross_kv_proj.register_forward_hook(lambda *_: calls.append(1))
    for i in range(3):
        denoiser(draw(B, T, A), denoiser.modulate(torch.tensor([0.3 * i])), context)
    assert not calls


def test_each_observation_token_is_attended_to():
    """Modulation sees their mean only; here its part is taken away."""
    denoiser = shaken(dit())
    torch.nn.init.zeros_(denoiser.observation_modulation.weight)
    tokens = condition().tokens.requires_grad_()
    answer(denoiser, draw(B, T, A), torch.rand(1), Condition(tokens=tokens)).square().sum().backward()
    assert (tokens.grad.abs().amax(2) > 1e-7).all()


def test_a_block_equals_attention_of_its_parts():
    """Self-attention, cross-attention and MLP against `Attention`, which is held against the formula."""
    torch.manual_seed(0)
    block = shaken(dit(n_layers=1)).blocks[0]
    h, tokens, modulation = draw(B, T // PATCH, D), draw(B, N, D, seed=4), draw(B, 1, 9 * D, seed=5)
    shifts, scales, gates = (part.chunk(3, dim=-1) for part in modulation.chunk(3, dim=-1))
    own, cross = Attention(D, HEADS, 0.0), Attention(D, HEADS, 0.0)
    copy_projections(own, *zip(block.qkv_proj.weight.chunk(3), block.qkv_proj.bias.chunk(3), strict=True))
    keys_values = zip(block.cross_kv_proj.weight.chunk(2), block.cross_kv_proj.bias.chunk(2), strict=True)
    copy_projections(cross, (block.cross_q_proj.weight, block.cross_q_proj.bias), *keys_values)
    own.out_proj, cross.out_proj = block.out_proj, block.cross_out_proj

    expected = h
    for i, branch in enumerate((lambda y: own(y, y, y), lambda y: cross(y, tokens, tokens), block.mlp)):
        normed = F.layer_norm(expected, (D,)) * (1 + scales[i]) + shifts[i]
        expected = expected + gates[i] * branch(normed)
    torch.testing.assert_close(block(h, modulation, block.memory(tokens)), expected, rtol=1e-4, atol=1e-5)


def copy_projections(attention, queries, keys, values):
    """Biases of keys have no effect, and `Attention` has none."""
    attention.q_proj.weight.data, attention.q_proj.bias.data = (part.data for part in queries)
    attention.k_proj.weight.data = keys[0].data
    attention.v_proj.weight.data, attention.v_proj.bias.data = (part.data for part in values)
