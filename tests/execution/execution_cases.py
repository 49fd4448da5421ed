"""Predictions that are the same however they are asked for, and the weighted mean of them by brute force."""

import math

import torch

B, T, A = 3, 5, 4


class Stream:
    """What a policy predicts, for each step and environment, and a record of what it was asked for."""

    def __init__(self, n_steps=40, batch_size=B, chunk_size=T, n_dims=A, dtype=torch.float64, samples=()):
        shape = (n_steps, *samples, batch_size, chunk_size, n_dims)
        generator = torch.Generator().manual_seed(0)
        self.chunks = torch.rand(shape, generator=generator, dtype=torch.float64).mul(2).sub(1).to(dtype)
        self.batch_size = batch_size
        self.step = 0
        self.calls = []  # (step, environments)

    def __call__(self, envs):
        self.calls.append((self.step, list(range(self.batch_size)) if envs is None else envs.tolist()))
        chunks = self.chunks[self.step]
        return chunks if envs is None else chunks[..., envs, :, :]


def rollout(executor, stream, n_steps, resets=None):
    """Actions (n_steps, B, A); ``resets`` are the environments that start anew before a step."""
    actions = []
    for stream.step in range(n_steps):
        if stream.step in (resets or {}):
            executor.reset(resets[stream.step])
        actions.append(executor.step(stream, stream.batch_size))
    return torch.stack(actions)


class Votes:
    """Every prediction that one environment ever got, averaged from scratch at each step."""

    def __init__(self, n_action_steps, growth):
        self.n_action_steps, self.growth = n_action_steps, growth
        self.chunks = []  # (start, from this step on, chunk)
        self.last = None

    def add(self, step, chunk, delay):
        ends = [start + self.n_action_steps for start, _, _ in self.chunks]
        in_time = min(step + delay, max(ends, default=step))
        self.chunks.append((step, max(step, in_time), chunk))

    def action(self, step):
        votes = [
            (self.growth * (step - start), chunk[step - start])
            for start, usable, chunk in self.chunks
            if usable <= step < start + self.n_action_steps
        ]
        if votes:
            heaviest = max(log_weight for log_weight, _ in votes)
            weights = [math.exp(log_weight - heaviest) for log_weight, _ in votes]
            mean = sum(w * vote for w, (_, vote) in zip(weights, votes, strict=True)) / sum(weights)
            self.last = mean
        return self.last
