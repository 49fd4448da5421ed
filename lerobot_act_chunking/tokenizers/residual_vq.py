"""Codes that are learned from the chunks they stand for."""

from typing import ClassVar

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.ranges import check_ranges
from lerobot_act_chunking.tokenizers.learned import LearnedTokenizer
from lerobot_act_chunking.tokenizers.quantizers import MovingCodebooks
from lerobot_act_chunking.tokenizers.spec import TokenizerSpec


class ResidualVqTokenizer(LearnedTokenizer):
    """VQ-BeT's tokenizer (Lee et al. 2024, section 3.2), with codebooks that follow the encodings."""

    settings: ClassVar[tuple[str, ...]] = ("vqvae_n_embed", *LearnedTokenizer.settings)
    finer: ClassVar[str] = "more levels (--policy.vqvae_num_layers) or codes (--policy.vqvae_n_embed)"

    @classmethod
    def from_spec(cls, spec: TokenizerSpec) -> "ResidualVqTokenizer":
        """A fresh tokenizer with these settings."""
        encoder, decoder = cls.coders(spec)
        quantizer = MovingCodebooks(
            spec.vqvae_embedding_dim,
            spec.vqvae_num_layers,
            spec.vqvae_n_embed,
            decay=spec.vqvae_decay,
            commitment_weight=spec.commitment_weight,
            kmeans_iters=spec.kmeans_iters,
            dead_code_threshold=spec.dead_code_threshold,
            rotation_trick=spec.rotation_trick,
        )
        return cls(encoder, decoder, quantizer)

    @classmethod
    def check(cls, spec: TokenizerSpec) -> None:
        """Refuse coders and codebooks that cannot work.

        Raises:
            ConfigurationError: naming the value and the way out.
        """
        super().check(spec)
        check_ranges(
            spec, "vqvae_n_embed", "vqvae_decay", "kmeans_iters", "dead_code_threshold", "commitment_weight"
        )
        if spec.rotation_trick and spec.vqvae_embedding_dim == 1:
            raise ConfigurationError(
                "rotation_trick needs a direction to turn, and vqvae_embedding_dim=1 has none: use more "
                "dimensions or rotation_trick=false"
            )
