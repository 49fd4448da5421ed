"""Small tokenizers and chunks."""

import torch

from lerobot_act_chunking.tokenizers.make import TOKENIZERS, make_tokenizer
from lerobot_act_chunking.tokenizers.spec import TokenizerSpec

N, C, A, D, M, G = 33, 7, 3, 6, 5, 2
SMALL = {
    "chunk_size": C,
    "action_dim": A,
    "vqvae_n_embed": M,
    "vqvae_num_layers": G,
    "vqvae_embedding_dim": D,
    "vqvae_enc_hidden_dim": 16,
    "vqvae_coder": "mlp",
    "vqvae_decay": 0.99,
    "commitment_weight": 0.25,
    "kmeans_iters": 20,
    "dead_code_threshold": 0.25,
    "rotation_trick": True,
    "fsq_levels": (3, 4),
    "n_bins": 9,
    "dct_coefficients": 4,
}
LEARNED = [name for name, kind in TOKENIZERS.items() if kind.is_learned]


def spec(tokenizer="residual_vq", **overrides):
    return TokenizerSpec(**{**SMALL, "tokenizer": tokenizer, **overrides})


def small(tokenizer="residual_vq", seed=0, **overrides):
    torch.manual_seed(seed)
    return make_tokenizer(spec(tokenizer, **overrides))


def chunks(n=N, seed=1):
    """Smooth chunks between -1 and 1, all alike but for their phase and rate."""
    phase, rate = torch.rand(2, n, 1, 1, generator=torch.Generator().manual_seed(seed))
    return torch.sin(6 * phase + torch.arange(A) + rate * torch.linspace(0, 1, C)[:, None])


def no_padding(n=N):
    return torch.zeros(n, C, dtype=torch.bool)


def state(tokenizer):
    return {name: value.clone() for name, value in tokenizer.state_dict().items()}


def same(first, second):
    return first.keys() == second.keys() and all(torch.equal(first[name], second[name]) for name in first)


def gradients(tokenizer):
    return {name: weight.grad.clone() for name, weight in tokenizer.named_parameters()}
