import pytest
import torch

from lerobot_act_chunking.heads.offsets import ConditionedOffset, TableOffset

N, G, M, C, A, D = 3, 2, 7, 5, 4, 16


@pytest.fixture
def inputs():
    generator = torch.Generator().manual_seed(0)
    return (
        torch.randn(N, D, generator=generator),
        torch.randint(M, (N, G), generator=generator),
        torch.randn(N, C, A, generator=generator),
    )


@pytest.mark.parametrize("hidden_dims", [(), (8,), (8, 12)])
def test_offsets_have_the_chunks_shape_and_all_weights_learn(inputs, hidden_dims):
    for head in (ConditionedOffset(D, hidden_dims, C, A), TableOffset(D, hidden_dims, G, M, C, A)):
        for parameter in head.parameters():
            parameter.data += 0.1 * torch.randn_like(parameter)
        out = head(*inputs)
        assert out.shape == (N, C, A)
        out.square().sum().backward()
        assert all(parameter.grad.any() for parameter in head.parameters())


@pytest.mark.parametrize("hidden_dims", [(), (8,)])
def test_training_starts_at_the_decoded_chunk(inputs, hidden_dims):
    head = ConditionedOffset(D, hidden_dims, C, A)
    assert not head(*inputs).any()
    head(*inputs).sum().backward()
    assert head.readout.weight.grad.any()


def test_the_conditioned_offset_sees_feature_and_chunk_and_not_the_codes(inputs):
    head = ConditionedOffset(D, (8,), C, A)
    torch.nn.init.normal_(head.readout.weight)
    features, codes, decoded = inputs
    before = head(*inputs)
    assert not torch.allclose(before, head(features + 1, codes, decoded))
    assert not torch.allclose(before, head(features, codes, decoded.flip(1)))
    assert torch.equal(before, head(features, (codes + 1) % M, decoded))


def test_the_table_holds_an_offset_for_every_value_of_every_code(inputs):
    head = TableOffset(D, (), G, M, C, A)
    features, codes, decoded = inputs
    table = (features @ head.readout.weight.T + head.readout.bias).reshape(N, G, M, C, A)
    for n, (first, second) in enumerate(codes.tolist()):
        expected = table[n, 0, first] + table[n, 1, second]
        torch.testing.assert_close(head(*inputs)[n], expected)
    assert torch.equal(head(*inputs), head(features, codes, decoded + 1))


def test_the_table_learns_at_the_codes_at_hand_alone(inputs):
    head = TableOffset(D, (), G, M, C, A)
    head(*inputs).sum().backward()
    learned = head.readout.bias.grad.reshape(G, M, C, A).flatten(2).any(-1)
    expected = torch.zeros(G, M, dtype=torch.bool)
    for g in range(G):
        expected[g, inputs[1][:, g]] = True
    assert torch.equal(learned, expected)
