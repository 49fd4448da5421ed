"""Codes that are the rounded dimensions of a learned encoding."""

import math
from typing import ClassVar

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.tokenizers.learned import LearnedTokenizer
from lerobot_act_chunking.tokenizers.quantizers import FiniteScalar
from lerobot_act_chunking.tokenizers.spec import TokenizerSpec

MOST_CODES = 2**16  # of a level; the vocabularies of language models are about as large


class FsqTokenizer(LearnedTokenizer):
    """Residual finite scalar quantisation (Mentzer et al. 2023) between an encoder and a decoder."""

    settings: ClassVar[tuple[str, ...]] = ("fsq_levels", *LearnedTokenizer.settings)
    finer: ClassVar[str] = "more levels (--policy.vqvae_num_layers) or dimensions (--policy.fsq_levels)"

    @classmethod
    def from_spec(cls, spec: TokenizerSpec) -> "FsqTokenizer":
        """A fresh tokenizer with these settings."""
        encoder, decoder = cls.coders(spec)
        quantizer = FiniteScalar(spec.vqvae_embedding_dim, spec.vqvae_num_layers, spec.fsq_levels)
        return cls(encoder, decoder, quantizer)

    @classmethod
    def check(cls, spec: TokenizerSpec) -> None:
        """Refuse coders and codes that cannot work.

        Raises:
            ConfigurationError: naming the value and the way out.
        """
        super().check(spec)
        if not spec.fsq_levels or min(spec.fsq_levels) < 2:
            raise ConfigurationError(
                f"fsq_levels={spec.fsq_levels} must name at least one dimension, each with 2 values or more, "
                "such as (8, 5, 5)"
            )
        if math.prod(spec.fsq_levels) > MOST_CODES:
            raise ConfigurationError(
                f"fsq_levels={spec.fsq_levels} make {math.prod(spec.fsq_levels)} codes, each with an "
                f"output of its own: at most {MOST_CODES}"
            )
