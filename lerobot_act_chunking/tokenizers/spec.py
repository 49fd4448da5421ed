"""Everything that a tokenizer is built from."""

import math
from dataclasses import dataclass, fields
from typing import Any

from lerobot_act_chunking.errors import ConfigurationError, unknown_choice

TOKENIZERS = ("residual_vq", "fsq", "uniform", "dct")
CODERS = ("mlp", "conv")
LEARNED = ("residual_vq", "fsq")
CODER_FIELDS = ("vqvae_num_layers", "vqvae_embedding_dim", "vqvae_enc_hidden_dim", "vqvae_coder")
MOST_CODES = 2**16  # of a level; the vocabularies of language models are about as large
BUILDING = {
    "residual_vq": ("vqvae_n_embed", *CODER_FIELDS),
    "fsq": ("fsq_levels", *CODER_FIELDS),
    "uniform": ("n_bins",),
    "dct": ("n_bins", "dct_coefficients"),
}
"""For each tokenizer the fields without which a trained one cannot be rebuilt, besides its sizes."""


@dataclass(frozen=True)
class TokenizerSpec:
    """What `make_tokenizer` builds. Only the settings of the named tokenizer count; the others are ignored.

    Attributes:
        tokenizer: ``residual_vq`` (VQ-BeT, Lee et al. 2024), ``fsq`` (residual finite scalar quantisation,
            Mentzer et al. 2023), ``uniform`` bins, or ``dct`` coefficients (FAST, Pertsch et al. 2025,
            without its byte pairs).
        chunk_size: C, actions per chunk.
        action_dim: A.
        vqvae_n_embed: M, codes per level of ``residual_vq``.
        vqvae_num_layers: G, levels of ``residual_vq`` and ``fsq``.
        vqvae_embedding_dim: D, width of an encoding.
        vqvae_enc_hidden_dim: hidden width of encoder and decoder.
        vqvae_coder: ``mlp`` over the flat chunk, or ``conv`` along it.
        vqvae_decay: gamma of the codebook's moving average.
        commitment_weight: beta, how much encodings are drawn to their codes.
        kmeans_iters: k-means iterations that place the first codes; 0 for random ones.
        dead_code_threshold: codes with less than this share of what all would have if they were used alike
            (moving average) are placed anew; 0 never.
        rotation_trick: pass gradients through the quantiser by rotation (Fifty et al. 2024), not straight.
        fsq_levels: values of each dimension of an ``fsq`` code; M is their product.
        n_bins: M of ``uniform`` and ``dct``.
        dct_coefficients: coefficients that ``dct`` keeps per action dimension, the lowest frequencies.
    """

    tokenizer: str
    chunk_size: int
    action_dim: int
    vqvae_n_embed: int = 16
    vqvae_num_layers: int = 2
    vqvae_embedding_dim: int = 64
    vqvae_enc_hidden_dim: int = 256
    vqvae_coder: str = "mlp"
    vqvae_decay: float = 0.99
    commitment_weight: float = 0.25
    kmeans_iters: int = 20
    dead_code_threshold: float = 0.25
    rotation_trick: bool = True
    fsq_levels: tuple[int, ...] = (4, 4)
    n_bins: int = 64
    dct_coefficients: int = 5

    @classmethod
    def from_fields(cls, source: Any, chunk_size: int, action_dim: int) -> "TokenizerSpec":
        """The spec whose other values are the attributes of ``source``, a policy's configuration."""
        sizes = {"chunk_size": chunk_size, "action_dim": action_dim}
        names = (field.name for field in fields(cls))
        values: dict[str, Any] = {name: getattr(source, name) for name in names if name not in sizes}
        return cls.from_values(values | sizes)

    @classmethod
    def from_values(cls, values: dict[str, Any]) -> "TokenizerSpec":
        """The spec with these values, as read from JSON or YAML."""
        levels: Any = tuple(values["fsq_levels"])
        return cls(**{**values, "fsq_levels": levels})

    @property
    def building(self) -> dict[str, Any]:
        """The fields that a trained tokenizer needs to be rebuilt; the others only say how it learned."""
        return {name: getattr(self, name) for name in ("tokenizer", "chunk_size", *BUILDING[self.tokenizer])}

    @property
    def is_learned(self) -> bool:
        """Whether there is anything to train."""
        return self.tokenizer in LEARNED

    def check(self) -> None:
        """Refuse values that cannot work.

        Raises:
            ConfigurationError: naming the value and the way out.
        """
        if self.tokenizer not in TOKENIZERS:
            raise unknown_choice("tokenizer", self.tokenizer, TOKENIZERS)
        self._check_least(1, "chunk_size", "action_dim")
        if self.is_learned:
            self._check_coders()
        if self.tokenizer == "residual_vq":
            self._check_codebook()
        elif self.tokenizer == "fsq":
            self._check_levels()
        else:
            self._check_least(2, "n_bins")
        if self.tokenizer == "dct" and not 1 <= self.dct_coefficients <= self.chunk_size:
            raise ConfigurationError(
                f"dct_coefficients={self.dct_coefficients} must be at least 1 and at most "
                f"chunk_size={self.chunk_size}: a chunk has no more"
            )

    def _check_coders(self) -> None:
        if self.vqvae_coder not in CODERS:
            raise unknown_choice("vqvae_coder", self.vqvae_coder, CODERS)
        self._check_least(1, "vqvae_num_layers", "vqvae_embedding_dim", "vqvae_enc_hidden_dim")

    def _check_codebook(self) -> None:
        self._check_least(2, "vqvae_n_embed")
        self._check_least(0, "kmeans_iters", "dead_code_threshold", "commitment_weight")
        if not 0 <= self.vqvae_decay < 1:
            raise ConfigurationError(
                f"vqvae_decay={self.vqvae_decay} must be at least 0 and below 1: the share that the "
                "codebook's moving average keeps in each step"
            )
        if self.rotation_trick and self.vqvae_embedding_dim == 1:
            raise ConfigurationError(
                "rotation_trick needs a direction to turn, and vqvae_embedding_dim=1 has none: use more "
                "dimensions or rotation_trick=false"
            )

    def _check_levels(self) -> None:
        if not self.fsq_levels or min(self.fsq_levels) < 2:
            raise ConfigurationError(
                f"fsq_levels={self.fsq_levels} must name at least one dimension, each with 2 values or more, "
                "such as (8, 5, 5)"
            )
        if math.prod(self.fsq_levels) > MOST_CODES:
            raise ConfigurationError(
                f"fsq_levels={self.fsq_levels} make {math.prod(self.fsq_levels)} codes, each with an "
                f"output of its own: at most {MOST_CODES}"
            )

    def _check_least(self, least: int, *names: str) -> None:
        for name in names:
            value = getattr(self, name)
            if not (value >= least and math.isfinite(value)):
                raise ConfigurationError(f"{name}={value} must be at least {least}, and finite")
