import math

import torch

from lerobot_act_chunking.sampling.held_draws import HeldDraws
from lerobot_act_chunking.sampling.noise import NoiseSource

G = 4


def draws(hold_steps=0.0, seed=0):
    return HeldDraws(NoiseSource(seed), (G,), torch.rand, hold_steps=hold_steps)


def test_numbers_lie_in_the_unit_interval_and_differ():
    drawn = draws().draw(50, n_samples=7)
    assert drawn.shape == (7, 50, G)
    assert ((drawn >= 0) & (drawn < 1)).all()
    assert drawn.unique().numel() == drawn.numel()


def test_an_environment_does_not_depend_on_the_others():
    together, alone = draws(), draws()
    for _ in range(3):
        torch.testing.assert_close(together.draw(5)[:, [2]], alone.draw(1, envs=[2]))


def test_a_reset_environment_begins_anew_and_others_go_on():
    used, undisturbed = draws(), draws()
    first = used.draw(3)
    undisturbed.draw(3)
    used.reset([1])
    second, expected = used.draw(3), undisturbed.draw(3)
    assert torch.equal(second[:, 1], first[:, 1])
    assert torch.equal(second[:, [0, 2]], expected[:, [0, 2]])


def test_held_numbers_last_until_the_reset():
    held = draws(math.inf)
    first = held.draw(3, n_samples=2)
    assert torch.equal(held.draw(3, n_samples=2), first)
    held.reset()
    assert torch.equal(held.draw(3, n_samples=2), first)  # as a fresh one
    assert not torch.equal(draws(math.inf, seed=1).draw(3, n_samples=2), first)


def test_numbers_are_held_for_so_many_steps():
    held = draws(hold_steps=3.0)
    drawn = [held.draw(2, step=step) for step in range(7)]
    assert [torch.equal(drawn[step], drawn[step + 1]) for step in range(6)] == [True, True, False] * 2
