"""What all denoisers have in common."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from jaxtyping import Float
from torch import Tensor, nn

from lerobot_act_chunking.nn.condition import Condition
from lerobot_act_chunking.nn.denoisers.spec import DenoiserInputs, DenoiserSpec

OUTPUT_STD = 1e-3
"""Of a new network's last weights: its answers are nearly zero, but its samples differ with their noise."""


@dataclass(frozen=True)
class Context:
    """What a denoiser makes of the observation alone, once per chunk.

    Attributes:
        modulation: (B, M), its part of all scales, shifts and gates.
        memory: keys and values (B, heads, N, d) of each layer that attends to the observation.
    """

    modulation: Float[Tensor, "B M"]
    memory: tuple[tuple[Tensor, Tensor], ...] = ()

    def repeat(self, n_samples: int) -> "Context":
        """The same for several samples of each environment, sample by sample."""
        if n_samples == 1:
            return self
        memory = tuple((k.repeat(n_samples, 1, 1, 1), v.repeat(n_samples, 1, 1, 1)) for k, v in self.memory)
        return Context(self.modulation.repeat(n_samples, 1), memory)


class Denoiser(nn.Module, ABC):
    """From noisy actions to what the process asks for.

    Scales, shifts and gates are sums of a part from the observation (`observe`, once per chunk) and a part
    from the time (`modulate`, a table over all steps), so that neither is computed again in every step.

    Attributes:
        per_token_time: whether each token may have a time of its own (prefix conditioning).
        reads_tokens: whether it is conditioned on tokens, not on a vector.
        adapted: pattern of the names of the layers that low-rank adapters change. The last layer is
            ``contract``; it is trained whole.
        patch_size: consecutive actions that make a token.
    """

    per_token_time: ClassVar[bool] = False
    reads_tokens: ClassVar[bool] = False
    adapted: ClassVar[str]
    patch_size: int = 1

    @classmethod
    @abstractmethod
    def from_spec(cls, spec: DenoiserSpec, inputs: DenoiserInputs) -> "Denoiser":
        """A fresh denoiser with these settings."""

    @abstractmethod
    def observe(self, condition: Condition) -> Context:
        """The part of the observation."""

    @abstractmethod
    def modulate(self, time: Float[Tensor, "*S"]) -> Float[Tensor, "*S M"]:
        """The part of the time."""

    @abstractmethod
    def forward(
        self,
        x: Float[Tensor, "B T A"],
        modulation: Float[Tensor, "#B M"] | Float[Tensor, "#B N M"],
        context: Context,
    ) -> Float[Tensor, "B T A"]:
        """The answer for noisy actions ``x``.

        Args:
            x: noisy actions.
            modulation: of their time, from `modulate`; for each token if `per_token_time`.
            context: of their observation, from `observe`.
        """
