"""What all tokenizers of action chunks promise."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor, nn

from lerobot_act_chunking.tokenizers.spec import TokenizerSpec


@dataclass(frozen=True)
class Reconstruction:
    """What training a tokenizer needs to know of one batch.

    Attributes:
        loss: one number per chunk, with the mean that is to be minimised; padded steps do not count.
        actions: the chunks, encoded and decoded.
        codes: what they were encoded to.
        metrics: plain numbers to log.
    """

    loss: Float[Tensor, " N"]
    actions: Float[Tensor, "N C A"]
    codes: Int64[Tensor, "N G"]
    metrics: dict[str, float]


class ActionTokenizer(nn.Module):
    """Codes for normalised chunks: G tokens, each one of M.

    Encoding never changes a tokenizer, whatever its mode; only `learn` does, in training mode.

    Attributes:
        settings: those without which a trained one cannot be rebuilt, besides its sizes.
        coarse_to_fine: the first code says most and each further one refines those before, as in residual
            quantisation. Otherwise all codes count alike.
        is_learned: whether there is anything to train.
        is_bounded: whether it only stands for actions in [-1, 1].
        finer: what makes its codes tell more, as advice.
        n_codes: G, tokens per chunk.
        vocabulary: M, values that each of them may have.
    """

    settings: ClassVar[tuple[str, ...]]
    coarse_to_fine: ClassVar[bool]
    is_learned: ClassVar[bool]
    is_bounded: ClassVar[bool]
    finer: ClassVar[str]
    n_codes: int
    vocabulary: int

    @classmethod
    @abstractmethod
    def from_spec(cls, spec: TokenizerSpec) -> "ActionTokenizer":
        """A fresh tokenizer with these settings."""

    @classmethod
    @abstractmethod
    def check(cls, spec: TokenizerSpec) -> None:
        """Refuse settings that cannot work.

        Raises:
            ConfigurationError: naming the value and the way out.
        """

    @abstractmethod
    def encode(self, actions: Float[Tensor, "N C A"]) -> Int64[Tensor, "N G"]:
        """The codes of these chunks. No gradients."""

    @abstractmethod
    def decode(self, codes: Int64[Tensor, "N G"]) -> Float[Tensor, "N C A"]:
        """The chunks that these codes stand for; differentiable in the decoder's weights."""

    def learn(
        self, actions: Float[Tensor, "N C A"], is_pad: Bool[Tensor, "N C"], seed: int
    ) -> Reconstruction:
        """One batch of training: moves the codebook (in training mode) and returns the loss to descend.

        Args:
            actions: chunks; padded steps must hold the nearest valid action (`data.masking.hold_padding`).
            is_pad: padded steps. Chunks of which more than half is padding teach nothing.
            seed: of what is drawn for this batch (k-means, revival of dead codes).
        """
        raise TypeError(f"{type(self).__name__} has nothing to learn")

    def forward(self, actions: Float[Tensor, "N C A"]) -> Float[Tensor, "N C A"]:
        """The chunks, encoded and decoded."""
        return self.decode(self.encode(actions))

    def reconstruction_error(
        self, actions: Float[Tensor, "N C A"], is_pad: Bool[Tensor, "N C"]
    ) -> Float[Tensor, " A"]:
        """Mean absolute error of encoding and decoding per action dimension, over the steps not padded."""
        with torch.no_grad():
            valid = ~is_pad[..., None]
            error = ((self(actions) - actions).abs() * valid).sum((0, 1))
            return error / valid.sum().clamp_min(1)
