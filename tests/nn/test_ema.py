import pytest
import torch
from torch import nn

from lerobot_act_chunking.nn.ema import WeightAverage


def test_decay_follows_the_published_schedule():
    average = WeightAverage(nn.Linear(2, 3), power=0.75, max_value=0.9)
    decays = []
    for _ in range(30):
        decays.append(average.decay())
        average.step += 1
    expected = [0.0, 0.0, 1 - 2**-0.75, 1 - 3**-0.75, 1 - 4**-0.75]
    assert decays[:5] == pytest.approx(expected)
    assert decays[-1] == 0.9


def test_averages_by_hand():
    network = nn.Linear(1, 1, bias=False)
    average = WeightAverage(network, power=1.0, max_value=1.0)
    expected = 0.0
    for n, value in enumerate([7.0, 3.0, 5.0, -2.0]):
        network.weight.data.fill_(value)
        average.update(network)
        decay = 1 - 1 / max(n, 1)
        expected = decay * expected + (1 - decay) * value
    assert average.network.weight.item() == pytest.approx(expected)
    assert average.step == 4


def test_is_a_copy_that_never_trains():
    network = nn.Linear(2, 3)
    average = WeightAverage(network, power=0.75, max_value=0.99)
    assert not any(p.requires_grad for p in average.parameters())
    assert all(p.requires_grad for p in network.parameters())
    network.weight.data += 1
    assert not torch.equal(average.network.weight, network.weight)


def test_restart_begins_anew():
    network = nn.Linear(2, 3)
    average = WeightAverage(network, power=0.75, max_value=0.99)
    for _ in range(3):
        average.update(network)
    network.weight.data += 1
    average.restart(network)
    assert torch.equal(average.network.weight, network.weight)
    assert average.step == 0


def test_buffers_are_copied():
    network = nn.BatchNorm1d(3)
    average = WeightAverage(network, power=0.75, max_value=0.9)
    network(torch.randn(5, 3))
    average.update(network)
    assert torch.equal(average.network.running_mean, network.running_mean)
    assert average.network.num_batches_tracked == 1
