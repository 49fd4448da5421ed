"""Low frequencies of a chunk in equal bins."""

import math
from typing import ClassVar

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.ranges import check_ranges
from lerobot_act_chunking.tokenizers.bins import from_bins, to_bins
from lerobot_act_chunking.tokenizers.spec import TokenizerSpec
from lerobot_act_chunking.tokenizers.tokenizer import ActionTokenizer


class DctTokenizer(ActionTokenizer):
    """Bins of each dimension's discrete cosine transform along the chunk, the first coefficients of it.

    FAST (Pertsch et al. 2025) without its byte pairs: G = n_coefficients A codes, the lowest frequency of all
    dimensions first. The transform is orthonormal: coefficients of actions between -1 and 1 lie between
    -sqrt(C) and sqrt(C), and their quantisation errors, at most sqrt(C) / n_bins, add up by their squares to
    those of the actions. An odd ``n_bins`` has a bin for zero, which most high frequencies are.

    Args:
        chunk_size: C.
        action_dim: A.
        n_bins: M.
        n_coefficients: coefficients kept for each action dimension; the rest are taken for zero.
    """

    settings: ClassVar[tuple[str, ...]] = ("n_bins", "dct_coefficients")
    coarse_to_fine: ClassVar[bool] = False
    is_learned: ClassVar[bool] = False
    is_bounded: ClassVar[bool] = True
    finer: ClassVar[str] = "more coefficients (--policy.dct_coefficients) or bins (--policy.n_bins)"

    def __init__(self, chunk_size: int, action_dim: int, n_bins: int, n_coefficients: int):
        super().__init__()
        self.coefficients = (n_coefficients, action_dim)
        self.n_codes = n_coefficients * action_dim
        self.vocabulary = n_bins
        self.limit = math.sqrt(chunk_size)
        self.waves: Float[Tensor, "K C"]
        self.register_buffer("waves", cosines(chunk_size)[:n_coefficients].float(), persistent=False)

    @classmethod
    def from_spec(cls, spec: TokenizerSpec) -> "DctTokenizer":
        """A fresh tokenizer with these settings."""
        return cls(spec.chunk_size, spec.action_dim, spec.n_bins, spec.dct_coefficients)

    @classmethod
    def check(cls, spec: TokenizerSpec) -> None:
        """Refuse fewer than two bins, and coefficients that a chunk does not have.

        Raises:
            ConfigurationError: naming the value.
        """
        check_ranges(spec, "n_bins")
        if not 1 <= spec.dct_coefficients <= spec.chunk_size:
            raise ConfigurationError(
                f"dct_coefficients={spec.dct_coefficients} must be at least 1 and at most "
                f"chunk_size={spec.chunk_size}: a chunk has no more"
            )

    @torch.no_grad()
    def encode(self, actions: Float[Tensor, "N C A"]) -> Int64[Tensor, "N G"]:
        """The bins of these chunks' coefficients."""
        with torch.autocast(actions.device.type, enabled=False):
            return to_bins(self.waves @ actions.float(), self.limit, self.vocabulary).flatten(1)

    def decode(self, codes: Int64[Tensor, "N G"]) -> Float[Tensor, "N C A"]:
        """The chunks with these coefficients."""
        coefficients = from_bins(codes, self.limit, self.vocabulary).unflatten(1, self.coefficients)
        with torch.autocast(codes.device.type, enabled=False):
            return self.waves.mT @ coefficients


def cosines(n: int) -> Float[Tensor, "n n"]:
    """The orthonormal DCT-II of n steps: row k holds the wave of k half periods, in double precision."""
    steps = torch.arange(n, dtype=torch.float64)
    waves = torch.cos(math.pi / n * (steps + 0.5) * steps[:, None]) * math.sqrt(2 / n)
    waves[0] /= math.sqrt(2)
    return waves
