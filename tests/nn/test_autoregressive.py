import pytest
import torch

from lerobot_act_chunking.nn.autoregressive import AutoregressiveDecoder, corrupt
from lerobot_act_chunking.nn.layers import LayerSpec

B, N, Q, A, D = 3, 7, 4, 2, 16


def make(pre_norm=True, n_layers=2, s=3, dtype=torch.float64):
    torch.manual_seed(0)
    spec = LayerSpec(D, 2, 24, 0.0, "gelu", pre_norm)
    decoder = AutoregressiveDecoder(spec, n_layers, Q, s, A).to(dtype).eval()
    for parameter in decoder.parameters():
        parameter.data += 0.1 * torch.randn_like(parameter)
    return decoder


def inputs(s=3, dtype=torch.float64):
    generator = torch.Generator().manual_seed(1)
    shapes = (B, N, D), (N, D), (B, Q * s, A)
    return [torch.randn(shape, generator=generator, dtype=dtype) for shape in shapes]


def actor(s):
    """Any function of a query's features."""
    weight = torch.randn(D, s * A, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    return lambda features: (features @ weight.to(features)).tanh().unflatten(-1, (s, A)).flatten(1, 2)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(("pre_norm", "n_layers", "s"), [(True, 1, 1), (True, 2, 3), (False, 3, 2)])
def test_generation_is_teacher_forcing_on_its_own_actions(pre_norm, n_layers, s, dtype):
    decoder, (memory, positions, _) = make(pre_norm, n_layers, s, dtype), inputs(s, dtype)
    seen = []

    def act(features):
        seen.append(features)
        return actor(s)(features)

    with torch.no_grad():
        generated = decoder.generate(memory, positions, Q, act)
        taught = decoder(memory, positions, generated)
    tolerance = 1e-5 if dtype == torch.float32 else 1e-12
    torch.testing.assert_close(torch.cat(seen, dim=1), taught, rtol=0, atol=tolerance)
    torch.testing.assert_close(actor(s)(taught), generated, rtol=0, atol=tolerance)


def test_fewer_queries_are_a_prefix():
    decoder, (memory, positions, _) = make(), inputs()
    with torch.inference_mode():
        whole = decoder.generate(memory, positions, Q, actor(3))
        start = decoder.generate(memory, positions, 2, actor(3))
    assert start.shape == (B, 6, A)
    torch.testing.assert_close(start, whole[:, :6], rtol=0, atol=0)


@pytest.mark.parametrize("pre_norm", [True, False])
def test_a_query_knows_all_actions_before_its_own_and_no_others(pre_norm):
    decoder, (memory, positions, actions) = make(pre_norm), inputs()
    actions.requires_grad_()
    features = decoder(memory, positions, actions)
    for q in range(Q):
        (gradient,) = torch.autograd.grad(features[:, q].square().sum(), actions, retain_graph=True)
        seen = gradient.abs().sum((0, 2)) > 0
        assert seen.tolist() == [step < 3 * q for step in range(3 * Q)], q


def test_hidden_blocks_are_not_seen():
    decoder, (memory, positions, actions) = make(), inputs()
    keep = torch.ones(B, Q, dtype=torch.bool)
    assert torch.equal(decoder(memory, positions, actions, keep), decoder(memory, positions, actions))
    keep[1, 0] = False
    other = actions.clone()
    other[1, :3] += 1
    hidden = decoder(memory, positions, actions, keep)
    assert torch.equal(hidden, decoder(memory, positions, other, keep))
    assert not torch.allclose(hidden[1, 1], decoder(memory, positions, actions)[1, 1])
    assert torch.equal(hidden[[0, 2]], decoder(memory, positions, actions)[[0, 2]])


def test_every_parameter_learns():
    decoder, (memory, positions, actions) = make(), inputs()
    keep = torch.tensor([True, False, True, True]).expand(B, -1)
    decoder(memory, positions, actions, keep).square().sum().backward()
    assert all(p.grad is not None and p.grad.abs().max() > 0 for p in decoder.parameters())


def test_queries_differ_by_their_places_and_samples_by_their_memories():
    decoder, (memory, positions, actions) = make(), inputs()
    same = decoder(memory, positions, torch.zeros_like(actions))
    assert not torch.allclose(same[:, 1], same[:, 2])
    assert not torch.allclose(same[0], same[1])


def test_it_generates_under_autocast():
    decoder, (memory, positions, _) = make(dtype=torch.float32), inputs(dtype=torch.float32)
    with torch.autocast("cpu", torch.bfloat16), torch.no_grad():
        half = decoder.generate(memory, positions, Q, actor(3))
    full = decoder.generate(memory, positions, Q, actor(3))
    torch.testing.assert_close(half.float(), full, rtol=0.1, atol=0.1)


def test_what_training_shows():
    actions = torch.zeros(2000, 6, A)
    generator = torch.Generator().manual_seed(0)
    shown, keep = corrupt(actions, 3, generator, 0.05, 0.3)
    assert keep.shape == (2000, 2)
    assert shown.std().item() == pytest.approx(0.05, rel=0.02)
    assert 1 - keep.float().mean().item() == pytest.approx(0.3, abs=0.03)
    again, _ = corrupt(actions, 3, torch.Generator().manual_seed(0), 0.05, 0.3)
    assert torch.equal(shown, again)
    plain, everything = corrupt(actions, 3, generator, 0.0, 0.0)
    assert torch.equal(plain, actions)
    assert everything.all()
