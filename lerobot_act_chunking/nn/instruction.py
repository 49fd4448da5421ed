"""What an instruction says, as one vector: read word by word, or as the mean of its words."""

from abc import ABC, abstractmethod

import torch
import torch.nn.functional as F  # noqa: N812
from jaxtyping import Bool, Float, Int64
from torch import Tensor, nn

N_QUERIES, VALUE_DIM = 4, 32


class InstructionReader(nn.Module, ABC):
    """Makes one vector of what a frozen sentence encoder says of each word.

    Attributes:
        dim: V, size of the vector.
    """

    dim: int

    @abstractmethod
    def forward(self, states: Float[Tensor, "n L E"], mask: Bool[Tensor, "n L"]) -> Float[Tensor, "n V"]:
        """The vector of each instruction; ``mask`` is true where there is a word."""

    @torch.no_grad()
    def fit(self, states: Float[Tensor, "n L E"], mask: Bool[Tensor, "n L"]) -> None:
        """Look at all instructions of the training once, before it begins."""


class WordReader(InstructionReader):
    """Attention over the words, by a few learned queries.

    The mean of the words hardly tells "from left to right" from "from right to left": the same words are in
    both. What the encoder says of each word does.

    Args:
        width: E, of the encoder's states.
    """

    def __init__(self, width: int):
        super().__init__()
        self.norm = nn.LayerNorm(width, elementwise_affine=False)
        self.scores = nn.Linear(width, N_QUERIES)
        self.values = nn.Linear(width, VALUE_DIM)
        self.dim = N_QUERIES * VALUE_DIM

    def forward(self, states: Float[Tensor, "n L E"], mask: Bool[Tensor, "n L"]) -> Float[Tensor, "n V"]:
        """What the queries find."""
        words = self.norm(states)
        weights = self.scores(words).masked_fill(~mask[..., None], -torch.inf).softmax(1)
        return (weights.transpose(1, 2) @ self.values(words)).flatten(1)


class MeanReader(InstructionReader):
    """The sentence embedding: the mean of the words, of length one, made as wide as the training's differ.

    Sentences about one scene lie close together; without their common part, and on the scale of what is left,
    they differ as much as other observations do.

    Args:
        width: E, of the encoder's states.
    """

    def __init__(self, width: int):
        super().__init__()
        self.dim = width
        self.mean: Tensor
        self.spread: Tensor
        self.register_buffer("mean", torch.zeros(width))
        self.register_buffer("spread", torch.tensor(width**-0.5))

    def forward(self, states: Float[Tensor, "n L E"], mask: Bool[Tensor, "n L"]) -> Float[Tensor, "n V"]:
        """Standardised embeddings."""
        return (embeddings(states, mask) - self.mean) / self.spread

    @torch.no_grad()
    def fit(self, states: Float[Tensor, "n L E"], mask: Bool[Tensor, "n L"]) -> None:
        """Standardise by these instructions; a single one has no spread and keeps its scale."""
        found = embeddings(states, mask)
        self.mean.copy_(found.mean(0))
        spread = (found - self.mean).square().mean().sqrt()
        if spread > 1e-4:
            self.spread.copy_(spread)


READERS: dict[str, type[InstructionReader]] = {"words": WordReader, "mean": MeanReader}
"""The readers. What is listed here can be asked for as ``language_reading``."""


def embeddings(states: Float[Tensor, "n L E"], mask: Bool[Tensor, "n L"]) -> Float[Tensor, "n E"]:
    """Sentence embeddings: the mean over words, of length one (sentence-transformers' pooling)."""
    weight = mask[..., None].to(states)
    return F.normalize((states * weight).sum(1) / weight.sum(1).clamp(min=1), dim=-1)


class InstructionEmbedding(nn.Module):
    """The vector of each sample's instruction, or a learned one in place of those that are left out.

    Args:
        reader: makes the vectors.
        with_null: whether instructions may be left out.
    """

    def __init__(self, reader: InstructionReader, *, with_null: bool = False):
        super().__init__()
        self.reader = reader
        self.null = nn.Parameter(torch.zeros(reader.dim)) if with_null else None

    def forward(
        self,
        states: Float[Tensor, "n L E"],
        mask: Bool[Tensor, "n L"],
        rows: Int64[Tensor, " B"],
        drop: Bool[Tensor, " B"] | None = None,
    ) -> Float[Tensor, "B V"]:
        """The vectors.

        Args:
            states: of different instructions.
            mask: their words.
            rows: which of them each sample has.
            drop: samples whose instruction is left out.
        """
        said = self.reader(states, mask)[rows]
        if drop is None or self.null is None:
            return said
        return torch.where(drop[:, None], self.null, said)
