"""Cases of `vqbet_chunked`."""

import torch
from lerobot.policies.pretrained import PreTrainedPolicy
from policy_case import ENVIRONMENT, STATE, TOP, VELOCITY, WRIST, Case, Kind, T, history_batch
from torch import Tensor

from lerobot_act_chunking.tokenizers.make import make_tokenizer

VQBET = {
    "chunk_size": T,
    "gpt_hidden_dim": 16,
    "gpt_n_layer": 2,
    "gpt_n_head": 2,
    "head_hidden_dims": (24,),
    "vqvae_n_embed": 6,
    "vqvae_embedding_dim": 8,
    "vqvae_enc_hidden_dim": 12,
    "n_bins": 9,
    "dct_coefficients": 3,
    "fsq_levels": (3, 3),
    "n_vqvae_training_steps": 1,
    "kmeans_iters": 2,
    "spatial_softmax_num_keypoints": 3,
    "vision_backbone": "small_cnn",
}
PARALLEL = {"sequentially_select": False, "use_ema": False}
LEROBOT_AT_T = {"n_obs_steps": 1, "n_action_pred_token": 1, "head_hidden_dims": (), "kmeans_iters": 0}


def noise(case: Case, batch_size: int, generator: torch.Generator) -> dict[str, Tensor]:
    n_codes = make_tokenizer(case.config().tokenizer_spec).n_codes
    return {"noise": torch.rand(batch_size, n_codes, generator=generator)}


def with_tokenizer(policy: PreTrainedPolicy) -> PreTrainedPolicy:
    """The policy behind the phase in which its tokenizer learns alone."""
    while policy.tokenizer_phase.comes_first:
        policy.train().forward(history_batch(policy))
    policy.eval().forward(history_batch(policy))
    return policy


KIND = Kind(VQBET, {"gpt_hidden_dim": 32, "bet_softmax_temperature": 0.0}, 400, noise, with_tokenizer)
CASES = [
    Case("state", "vqbet_chunked", STATE),
    Case("joint", "vqbet_chunked", STATE | VELOCITY, {"tokenizer_training": "joint", "use_ema": False}),
    Case("fsq", "vqbet_chunked", ENVIRONMENT | TOP, {"tokenizer": "fsq", "vqvae_coder": "conv"}),
    Case("uniform", "vqbet_chunked", STATE | TOP | WRIST, {"tokenizer": "uniform"}),
    Case("dct", "vqbet_chunked", STATE | VELOCITY | ENVIRONMENT, {"tokenizer": "dct"} | PARALLEL),
    Case("paper", "vqbet_chunked", STATE | TOP, {"preset": "paper"} | LEROBOT_AT_T),
    Case("sampled", "vqbet_chunked", STATE, {"offset_target": "sampled", "code_hold": "episode"}),
]
