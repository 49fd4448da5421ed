"""Everything that a tokenizer is built from."""

from dataclasses import dataclass, fields
from typing import Any


@dataclass(frozen=True, kw_only=True)
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
    vqvae_n_embed: int
    vqvae_num_layers: int
    vqvae_embedding_dim: int
    vqvae_enc_hidden_dim: int
    vqvae_coder: str
    vqvae_decay: float
    commitment_weight: float
    kmeans_iters: int
    dead_code_threshold: float
    rotation_trick: bool
    fsq_levels: tuple[int, ...]
    n_bins: int
    dct_coefficients: int

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
