"""Exponential moving average of a network's weights."""

from copy import deepcopy

import torch
from torch import Tensor, nn

from lerobot_act_chunking.nn.buffers import CountsOnCpu


class WeightAverage[NetworkT: nn.Module](CountsOnCpu):
    """A slowly following copy of a network, for evaluation.

    The decay rises with the number of updates, ``1 - step^-power`` up to ``max_value`` (Diffusion Policy's
    schedule), so that a short run is not dominated by its initial weights. Weights and step are part of the
    state dict: a resumed run continues exactly.
    """

    counts = ("step",)

    def __init__(self, network: NetworkT, *, power: float, max_value: float):
        super().__init__()
        self.network: NetworkT = deepcopy(network).requires_grad_(False)
        self.power = power
        self.max_value = max_value
        self.step: Tensor
        self.register_buffer("step", torch.zeros((), dtype=torch.int64))

    def decay(self) -> float:
        """Weight of the old average in the next update."""
        return min(1 - max(int(self.step), 1) ** -self.power, self.max_value)

    @torch.no_grad()
    def update(self, network: NetworkT) -> None:
        """Move the average towards ``network``; the first two updates copy it. Buffers are always copied."""
        average: list[Tensor] = list(self.network.parameters())
        weights: list[Tensor] = list(network.parameters())
        torch._foreach_lerp_(average, weights, 1 - self.decay())  # pyright: ignore[reportPrivateImportUsage]
        for mine, buffer in zip(self.network.buffers(), network.buffers(), strict=True):
            mine.copy_(buffer)
        self.step += 1

    @torch.no_grad()
    def restart(self, network: NetworkT) -> None:
        """Begin a new average at ``network``."""
        self.network.load_state_dict(network.state_dict())
        self.step.zero_()
