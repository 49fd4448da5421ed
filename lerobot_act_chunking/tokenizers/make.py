"""From a `TokenizerSpec` to a tokenizer."""

from lerobot_act_chunking.tokenizers.coders import make_coders
from lerobot_act_chunking.tokenizers.dct import DctTokenizer
from lerobot_act_chunking.tokenizers.learned import LearnedTokenizer
from lerobot_act_chunking.tokenizers.quantizers import FiniteScalar, MovingCodebooks, Quantizer
from lerobot_act_chunking.tokenizers.spec import TokenizerSpec
from lerobot_act_chunking.tokenizers.tokenizer import ActionTokenizer
from lerobot_act_chunking.tokenizers.uniform import UniformTokenizer


def make_tokenizer(spec: TokenizerSpec) -> ActionTokenizer:
    """A fresh tokenizer.

    Raises:
        ConfigurationError: naming a value that cannot work.
    """
    spec.check()
    if spec.tokenizer == "uniform":
        return UniformTokenizer(spec.chunk_size, spec.action_dim, spec.n_bins)
    if spec.tokenizer == "dct":
        return DctTokenizer(spec.chunk_size, spec.action_dim, spec.n_bins, spec.dct_coefficients)
    encoder, decoder = make_coders(
        spec.vqvae_coder,
        spec.chunk_size,
        spec.action_dim,
        dim=spec.vqvae_embedding_dim,
        hidden_dim=spec.vqvae_enc_hidden_dim,
    )
    return LearnedTokenizer(encoder, decoder, _make_quantizer(spec))


def _make_quantizer(spec: TokenizerSpec) -> Quantizer:
    if spec.tokenizer == "fsq":
        return FiniteScalar(spec.vqvae_embedding_dim, spec.vqvae_num_layers, spec.fsq_levels)
    return MovingCodebooks(
        spec.vqvae_embedding_dim,
        spec.vqvae_num_layers,
        spec.vqvae_n_embed,
        decay=spec.vqvae_decay,
        commitment_weight=spec.commitment_weight,
        kmeans_iters=spec.kmeans_iters,
        dead_code_threshold=spec.dead_code_threshold,
        rotation_trick=spec.rotation_trick,
    )
