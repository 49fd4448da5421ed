"""Tokens that are combinations of a few vectors."""

from typing import NamedTuple

import torch
import torch.nn.functional as F  # noqa: N812
from jaxtyping import Float
from torch import Tensor, nn


class Span(NamedTuple):
    """Tokens ``weights @ vectors``. A linear layer maps the few vectors in place of the many tokens.

    A hundred actions of 14 numbers, embedded, are combinations of 15 vectors; a hundred queries that read
    three memory tokens with eight heads, of 24. The results are those of the tokens, up to rounding.

    Attributes:
        weights: of the R vectors, for each token.
        vectors: shared by the tokens of a sample, or of all samples.
    """

    weights: Float[Tensor, "B N R"]
    vectors: Float[Tensor, "*B R D"]

    def tokens(self) -> Float[Tensor, "B N D"]:
        """The tokens themselves."""
        return self.weights @ self.vectors

    def through(
        self, layer: nn.Linear, positions: Float[Tensor, "N D"] | None = None
    ) -> Float[Tensor, "B N O"]:
        """What ``layer`` makes of the tokens, after ``positions`` were added to them."""
        mapped = self.weights @ F.linear(self.vectors, layer.weight)
        constant = layer.bias if positions is None else F.linear(positions, layer.weight, layer.bias)
        return mapped if constant is None else mapped + constant

    def normalized(self, norm: nn.LayerNorm) -> "Span":
        """What ``norm`` makes of the tokens: but for their scale, it is linear, too."""
        centred = self.vectors - self.vectors.mean(-1, keepdim=True)
        variance = (self.weights @ centred).square().mean(-1, keepdim=True)
        weights = self.weights * (variance + norm.eps).rsqrt()
        bias = norm.bias.expand(*centred.shape[:-2], 1, -1)
        return Span(F.pad(weights, (0, 1), value=1.0), torch.cat((centred * norm.weight, bias), dim=-2))


def embedded(layer: nn.Linear, x: Float[Tensor, "B N I"]) -> Span:
    """What ``layer`` makes of ``x``, in the span of its columns and its bias."""
    return Span(F.pad(x, (0, 1), value=1.0), torch.cat((layer.weight.t(), layer.bias[None])))


def join(*spans: Span) -> Span:
    """The tokens of all, one behind the other; each has vectors of its own, shared by all samples."""
    n_vectors, start, weights = sum(len(span.vectors) for span in spans), 0, []
    for span in spans:
        end = start + len(span.vectors)
        weights.append(F.pad(span.weights, (start, n_vectors - end)))
        start = end
    return Span(torch.cat(weights, dim=1), torch.cat([span.vectors for span in spans]))


Tokens = Float[Tensor, "B N D"] | Span
"""A sequence of tokens, in either form."""
