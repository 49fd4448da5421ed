"""A policy's life in one mode of PyTorch: acts, is evaluated, trains, acts, trains."""

from contextlib import nullcontext

import torch


def train(policy, batch):
    policy.train()
    optimizer = torch.optim.SGD(policy.get_optim_params(), lr=1e-3)
    loss, _ = policy.forward(batch)
    loss.backward()
    optimizer.step()
    if hasattr(policy, "update"):
        policy.update()
    return loss.detach().clone()


def act(policy, observation):
    return [policy.select_action(dict(observation)).clone() for _ in range(4)]


def live(policy, observation, batch, mode):
    """What a policy does and loses that acts in ``mode``, and trains and acts outside of it in between."""
    torch.manual_seed(5)
    with mode:
        seen = {
            key: value.clone() for key, value in observation.items()
        }  # made in this mode, as by processors
        first = act(policy, seen)
        policy.reset([1])
        first += act(policy, seen)
        policy.eval().forward(batch)
    between = act(policy, observation)
    losses = [train(policy, batch)]
    with mode:
        policy.reset()
        again = [policy.predict_action_chunk(seen).clone(), *act(policy, seen)]
    losses.append(train(policy, batch))
    return [*first, *between, *again, *losses]


def assert_the_mode_does_not_matter(make_policy, observation, batch):
    modes = (nullcontext(), torch.inference_mode())
    lives = [live(make_policy(), observation, batch, mode) for mode in modes]
    for expected, found in zip(*lives, strict=True):
        assert torch.equal(expected, found)
