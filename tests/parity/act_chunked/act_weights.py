"""The map of weights from LeRobot's ``act`` to `act_chunked`, and what it makes of gradients."""

from lerobot.policies.act.modeling_act import ACTPolicy
from torch import Tensor

from lerobot_act_chunking.policies.act_chunked.importing.weights import WeightMap


class GradientMap(WeightMap):
    """Moves gradients, under the weights' names."""

    def start(self, layer: str) -> Tensor:
        """The constant's own gradient arrives at the last addition that forms it."""
        self.take_self_attention(layer)
        self.take(f"{layer}.self_attn.out_proj.weight")
        bias = self.take(f"{layer}.self_attn.out_proj.bias")
        self.take(f"{layer}.norm1.weight")
        shift = self.take(f"{layer}.norm1.bias")
        return bias if self.config.pre_norm else shift


def convert(
    theirs: dict[str, Tensor], policy: ACTPolicy, *, gradients: bool = False
) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    """Our state dict (or gradients), and LeRobot's entries that have no effect on any output."""
    mapping = (GradientMap if gradients else WeightMap)(theirs, policy.config)
    return mapping.convert(), mapping.without_effect
