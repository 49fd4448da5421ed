"""`act_chunking_runtime.limits` for tensors, on any device and in any precision."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from act_chunking_runtime import limits
from lerobot_act_chunking.execution.arrays import array_of
from lerobot_act_chunking.execution.environments import Environments


class ActionLimits(limits.ActionLimits):
    """Holds executed actions within a range, and within a change from one control step to the next."""

    def __init__(self, names: Sequence[str], **numbers: Float[Tensor, " A"]):
        super().__init__(names, **{name: array_of(value) for name, value in numbers.items()})

    def reset(self, envs: Environments = None) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """A rollout begins in these environments; None: in all. Counts go on."""
        super().reset(None if envs is None else envs.cpu().numpy())

    def __call__(self, actions: Float[Tensor, "B A"]) -> Float[Tensor, "B A"]:
        """The actions of this control step that may be executed, in the units of the demonstrations."""
        return torch.from_numpy(self.hold(array_of(actions))).to(actions)

    def normalised(self, actions: Float[Tensor, "B A"]) -> Float[Tensor, "B A"]:
        """As a call, of actions in the units of a policy."""
        return torch.from_numpy(self.hold_normalised(array_of(actions))).to(actions)
