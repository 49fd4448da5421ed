import math

import torch

from lerobot_act_chunking.nn.denoisers.time import StepEmbedding, UnitTimeEmbedding

D = 16


def test_unit_times_have_periods_from_0_004_to_4():
    """Half a period turns sine and cosine over; frequencies are in one ratio (pi0's embedding)."""
    embedding = UnitTimeEmbedding(D)
    periods = 2 * math.pi / embedding.frequencies
    torch.testing.assert_close(periods[[0, -1]], torch.tensor([0.004, 4.0]))
    ratios = periods[1:] / periods[:-1]
    torch.testing.assert_close(ratios, torch.full((D // 2 - 1,), 1000 ** (1 / (D // 2 - 1))))
    slowest = [D // 2 - 1, D - 1]
    torch.testing.assert_close(
        embedding(torch.tensor(1.0))[slowest], torch.tensor([1.0, 0.0]), rtol=0, atol=1e-6
    )


def test_unit_times_differ_where_a_step_embedding_hardly_does():
    """A tenth of the way moves the embedding by about its own length; LeRobot's flow policy: by 2 %."""
    times = torch.tensor([0.5, 0.6])
    moved = {}
    for name, embedding in (("unit", UnitTimeEmbedding(256)), ("step", StepEmbedding(256))):
        first, second = embedding(times)
        moved[name] = (second - first).norm() / first.norm()
    assert moved["unit"] > 0.5
    assert moved["step"] < 0.05


def test_any_shape_of_times():
    for embedding in (UnitTimeEmbedding(D), StepEmbedding(D)):
        times = torch.rand(3, 5)
        assert embedding(times).shape == (3, 5, D)
        torch.testing.assert_close(embedding(times)[1, 2], embedding(times[1, 2]))


def test_step_embedding_by_hand():
    out = StepEmbedding(4)(torch.tensor(7.0))
    expected = [math.sin(7), math.sin(7e-4), math.cos(7), math.cos(7e-4)]
    torch.testing.assert_close(out, torch.tensor(expected))


def test_embeddings_are_not_stored():
    assert not UnitTimeEmbedding(D).state_dict()
