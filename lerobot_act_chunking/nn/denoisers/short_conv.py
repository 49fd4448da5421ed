"""Convolutions over few positions."""

import torch.nn.functional as F  # noqa: N812
from jaxtyping import Float
from torch import Tensor, nn

FEW_POSITIONS = 64  # in the whole batch
MANY_WEIGHTS = 2**22


class ShortConv1d(nn.Conv1d):
    """A convolution that uses its weights as they lie in memory if the CPU would spend its time moving them.

    oneDNN copies the weights into a layout of its own on every call. Where they outnumber the positions that
    share them by far, as in a wide network that acts for one environment, the copy takes several times as
    long as the convolution, which is one matrix product. Parameters and results are those of `nn.Conv1d`.
    """

    def forward(self, input: Float[Tensor, "B C L"]) -> Float[Tensor, "B D M"]:  # noqa: A002
        """The convolution of ``input``."""
        few = len(input) * input.shape[2] <= FEW_POSITIONS
        if input.device.type != "cpu" or not few or self.weight.numel() < MANY_WEIGHTS:
            return super().forward(input)
        padding = int(self.padding[0])
        windows = F.pad(input, (padding, padding)).unfold(2, *self.kernel_size, *self.stride)  # (B, C, M, k)
        product = self.weight.flatten(1) @ windows.transpose(2, 3).flatten(1, 2)
        return product if self.bias is None else product + self.bias[:, None]
