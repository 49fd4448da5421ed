"""Temporal ensembling of overlapping chunks."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from lerobot_act_chunking.execution.executor import ChunkBuffer


class TemporalEnsemble(ChunkBuffer):
    """Executes the weighted mean of all predictions for the current step (ACT, Zhao et al. 2023, alg. 2).

    Predictions for one step, numbered i = 0, 1, ... from the oldest, weigh ``exp(-coeff * n_action_steps *
    i)``, as in LeRobot (which replans at every step): a positive coefficient favours old predictions, a
    negative one new ones. The mean is kept as a running average in a ring of one cell per future step: O(T)
    memory and time, whatever the number of overlapping chunks, and no weight exceeds 1, so no coefficient
    overflows.
    """

    def __init__(self, chunk_size: int, n_action_steps: int, coeff: float):
        self.chunk_size = chunk_size
        self._offsets = torch.arange(chunk_size)
        self._gains = ensemble_gains(math.ceil(chunk_size / n_action_steps), coeff * n_action_steps)
        self.reset()

    def reset(self) -> None:
        """Forget all predictions."""
        self._mean: Tensor | None = None
        self._counts = torch.zeros(self.chunk_size, dtype=torch.int64)
        self._head = 0

    def add(self, chunk: Float[Tensor, "B T A"]) -> None:
        """Average a full chunk into the cells of its steps."""
        if self._mean is None:
            self._mean = torch.zeros_like(chunk)
        cells = (self._head + self._offsets) % self.chunk_size
        gains = self._gains[self._counts[cells]].to(chunk)[:, None]
        cells = cells.to(chunk.device)
        self._mean[:, cells] += gains * (chunk - self._mean[:, cells])
        self._counts += 1

    def pop(self) -> Float[Tensor, "B A"]:
        """The mean for the current step; its cell is emptied for the step one chunk ahead."""
        if self._mean is None or self._counts[self._head] == 0:
            raise IndexError("no prediction covers this step: add a chunk first")
        action = self._mean[:, self._head].clone()
        self._mean[:, self._head] = 0
        self._counts[self._head] = 0
        self._head = (self._head + 1) % self.chunk_size
        return action


def ensemble_gains(n_chunks: int, decay: float) -> Float[Tensor, " C"]:
    """Share of the prediction that follows c others in their common mean, for c = 0, 1, ...

    It is ``w_c / (w_0 + ... + w_c)`` with ``w_i = exp(-decay * i)``, from ratios of at most 1, in float64.
    """
    ratios = torch.exp(-abs(decay) * torch.arange(n_chunks, dtype=torch.float64))
    totals = ratios.cumsum(0)
    return ratios / totals if decay >= 0 else 1 / totals
