"""Cases of `vqbet_chunked`."""

import torch
from lerobot.policies.pretrained import PreTrainedPolicy
from policy_case import ENVIRONMENT, STATE, TOP, VELOCITY, WRIST, Case, Kind, T, history_batch
from torch import Tensor

from lerobot_act_chunking.tokenizers.coders import CODERS
from lerobot_act_chunking.tokenizers.make import TOKENIZERS, make_tokenizer

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
_SMALL = {"gpt_n_layer": 1, "n_obs_steps": 2}
EXPORTED = [  # the gate exports the first
    Case("history", "vqbet_chunked", STATE, _SMALL),
    *(
        Case(f"tokenizer {name}", "vqbet_chunked", STATE, {**_SMALL, "tokenizer": name})
        for name in TOKENIZERS
    ),
    Case("held codes", "vqbet_chunked", STATE, {"top_p": 0.9, "code_hold": "episode"}),
    Case("parallel", "vqbet_chunked", STATE | TOP, PARALLEL),
]
DETERMINISTIC = {"bet_softmax_temperature": 0.0}
DRAWING = {"bet_softmax_temperature": 1.0}
SAMPLING = [
    Case("state", "vqbet_chunked", STATE, {"top_p": 1.0}),
    Case("held codes", "vqbet_chunked", STATE, {"top_p": 1.0, "code_hold": "episode"}),
]
HISTORY = {"n_obs_steps": 3, "execution": "receding", "replan_interval": 1}
KEPT = [  # what a policy can keep from step to step beside its plan
    Case("frames", "vqbet_chunked", STATE | TOP, HISTORY),
    Case("held codes", "vqbet_chunked", STATE, {"code_hold": "episode", "execution": "ensemble"}),
]
LONG = [  # chunks longer than some episodes
    Case("vqbet", "vqbet_chunked", STATE, {"chunk_size": 12}),
    Case("seconds", "vqbet_chunked", STATE, {"chunk_size": None, "horizon_s": 1.2, "fps": 10}),
]
_ADAPTED = (
    *({"tokenizer": kind} for kind in TOKENIZERS),
    *({"offset_mode": kind} for kind in ("code_conditioned", "table")),
    *({"vqvae_coder": kind} for kind in CODERS),
    {"sequentially_select": False},
)
ADAPTED = [Case(str(each), "vqbet_chunked", STATE | ENVIRONMENT | TOP, each) for each in _ADAPTED]
WEIGHTED = [(Case("state", "vqbet_chunked", STATE), "offset_loss_weight")]  # terms of the loss
TRAINED = (
    "--policy.gpt_hidden_dim=16 --policy.gpt_n_layer=1 --policy.chunk_size=5 --policy.vqvae_n_embed=3 "
    "--policy.n_vqvae_training_steps=3 --policy.offset_target=sampled"
)
SHORT = {  # short chunks, to be evaluated
    "chunk_size": 4,
    "chunk_stride": 4,
    "gpt_hidden_dim": 16,
    "gpt_n_layer": 1,
    "tokenizer": "fsq",
}
EVALUATED = [  # with these settings on the command line
    ("vqbet_chunked", "--policy.bet_softmax_temperature=0 --policy.execution=receding"),
    ("vqbet_chunked", "--policy.code_hold=episode --policy.top_p=0.5"),
    ("vqbet_chunked", "--policy.execution=coherence --policy.noise_seed=3"),
]

TINY = {  # for random configurations
    "chunk_size": 6,
    "gpt_hidden_dim": 8,
    "gpt_n_layer": 1,
    "gpt_n_head": 2,
    "head_hidden_dims": (9,),
    "vqvae_n_embed": 4,
    "vqvae_embedding_dim": 5,
    "vqvae_enc_hidden_dim": 7,
    "n_vqvae_training_steps": 1,
    "kmeans_iters": 1,
    "spatial_softmax_num_keypoints": 3,
    "n_bins": 9,
}
INDIVISIBLE = [("vqbet_chunked", {"gpt_hidden_dim": 20}, "gpt_hidden_dim", "gpt_n_head")]
_WIDE = {"gpt_hidden_dim": 2**14, "gpt_n_layer": 50}
TOO_COSTLY = [
    ("vqbet_chunked", _WIDE, "billion weights, more than 4"),
    ("vqbet_chunked", {"tokenizer": "fsq"} | _WIDE, "billion weights"),
    ("vqbet_chunked", {"chunk_size": 2000, "n_action_pred_token": 600}, "set --policy.chunk_size to 1666"),
    ("vqbet_chunked", {"tokenizer": "fsq", "fsq_levels": (99, 99, 99)}, "make 970299 codes"),
]

COHERENCE = {"execution": "coherence"}
PROVOKED = [  # errors whose text names the way out
    ("vqbet_chunked", {"n_action_steps": 1, "execution": "receding"}),
    ("vqbet_chunked", {"adaptive_scale": 2.0}),
    ("vqbet_chunked", {"adaptive_kernel": "gate"}),
    ("vqbet_chunked", {"execution": "open_loop", "latency_steps": 3}),
    ("vqbet_chunked", {"replan_s": 0.001, "fps": 50.0}),
    ("vqbet_chunked", {"tokenizer": "dct", "tokenizer_training": "joint", "use_ema": False}),
    ("vqbet_chunked", {"tokenizer_training": "joint"}),
    ("vqbet_chunked", {"tokenizer": "uniform", "offset_mode": "table"}),
    ("vqbet_chunked", {**COHERENCE, "bet_softmax_temperature": 0.0}),
    ("vqbet_chunked", {**COHERENCE, "code_hold": "episode"}),
]
