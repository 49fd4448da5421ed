"""Normalisation layers of backbones, and their weights in the order that is fastest."""

from typing import Literal

import torch
import torch.nn.functional as F  # noqa: N812
from jaxtyping import Float
from torch import Tensor, nn
from torchvision.ops.misc import FrozenBatchNorm2d

BackboneNorm = Literal["group", "frozen_batch"]

GROUP_SIZE = 16  # least channels per group, as in Diffusion Policy's ResNet


def group_norm(channels: int) -> nn.GroupNorm:
    """GroupNorm with groups of 16 channels or a few more, so that they divide evenly.

    There are no batch statistics to drift or to break weight averaging.
    """
    n_groups = next(n for n in range(max(1, channels // GROUP_SIZE), 0, -1) if channels % n == 0)
    return nn.GroupNorm(n_groups, channels)


class FrozenBatchNorm(FrozenBatchNorm2d):
    """torchvision's, computed by one kernel in place of several."""

    weight: Tensor
    bias: Tensor
    running_mean: Tensor
    running_var: Tensor

    def forward(self, x: Float[Tensor, "B C h w"]) -> Float[Tensor, "B C h w"]:
        """Shift and scale each channel by what was learned before."""
        mean, var = self.running_mean, self.running_var
        return F.batch_norm(x, mean, var, self.weight, self.bias, training=False, eps=self.eps)


def frozen(norm: nn.BatchNorm2d) -> FrozenBatchNorm:
    """The same shift and scale, learned no further."""
    layer = FrozenBatchNorm(norm.num_features, eps=norm.eps)
    names = [name for name, _ in layer.named_buffers()]
    layer.load_state_dict({name: value for name, value in norm.state_dict().items() if name in names})
    return layer


def replace_batch_norm(module: nn.Module, norm: BackboneNorm) -> None:
    """Put layers of the kind ``norm`` in place of every batch normalisation inside ``module``.

    Frozen ones take over what was learned. Layers that also activate, as timm's, go on doing so.
    """
    for name, child in module.named_children():
        if not isinstance(child, nn.BatchNorm2d):
            replace_batch_norm(child, norm)
            continue
        layer: nn.Module = frozen(child) if norm == "frozen_batch" else group_norm(child.num_features)
        activation = getattr(child, "act", None)
        setattr(module, name, layer if activation is None else nn.Sequential(layer, activation))


class ChannelsLastInEval(nn.Module):
    """Keeps its weights channels-last in evaluation on a CPU: one image takes half the time.

    PyTorch otherwise reorders every weight in each call. In training they are stored as everyone expects.
    """

    def train(self, mode: bool = True) -> "ChannelsLastInEval":
        """Set the mode, and the order of the weights in memory."""
        if mode != self.training:
            on_cpu = next(self.parameters()).device.type == "cpu"
            layout = torch.channels_last if on_cpu and not mode else torch.contiguous_format
            self.to(memory_format=layout)  # pyright: ignore[reportCallIssue]  (missing in its overloads)
        return super().train(mode)
