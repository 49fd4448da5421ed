"""Every action of a chunk in one of equal bins."""

from typing import ClassVar

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from lerobot_act_chunking.ranges import check_ranges
from lerobot_act_chunking.tokenizers.bins import from_bins, to_bins
from lerobot_act_chunking.tokenizers.spec import TokenizerSpec
from lerobot_act_chunking.tokenizers.tokenizer import ActionTokenizer


class UniformTokenizer(ActionTokenizer):
    """Bins over [-1, 1] of each dimension of each step: G = C A codes, step by step.

    Actions between -1 and 1 come back with an error of at most 1 / n_bins.

    Args:
        chunk_size: C.
        action_dim: A.
        n_bins: M.
    """

    settings: ClassVar[tuple[str, ...]] = ("n_bins",)
    coarse_to_fine: ClassVar[bool] = False
    is_learned: ClassVar[bool] = False
    is_bounded: ClassVar[bool] = True
    finer: ClassVar[str] = "more bins (--policy.n_bins)"

    def __init__(self, chunk_size: int, action_dim: int, n_bins: int):
        super().__init__()
        self.chunk = (chunk_size, action_dim)
        self.n_codes = chunk_size * action_dim
        self.vocabulary = n_bins

    @classmethod
    def from_spec(cls, spec: TokenizerSpec) -> "UniformTokenizer":
        """A fresh tokenizer with these settings."""
        return cls(spec.chunk_size, spec.action_dim, spec.n_bins)

    @classmethod
    def check(cls, spec: TokenizerSpec) -> None:
        """Refuse fewer than two bins.

        Raises:
            ConfigurationError: naming the value.
        """
        check_ranges(spec, "n_bins")

    @torch.no_grad()
    def encode(self, actions: Float[Tensor, "N C A"]) -> Int64[Tensor, "N G"]:
        """The bins of these chunks' actions."""
        return to_bins(actions.float(), 1.0, self.vocabulary).flatten(1)

    def decode(self, codes: Int64[Tensor, "N G"]) -> Float[Tensor, "N C A"]:
        """The centres of these bins."""
        return from_bins(codes, 1.0, self.vocabulary).unflatten(1, self.chunk)
