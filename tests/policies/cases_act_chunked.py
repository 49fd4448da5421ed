"""Cases of `act_chunked`."""

import math

import torch
from policy_case import ENVIRONMENT, STATE, TOP, VELOCITY, WRIST, Case, Kind, T
from torch import Tensor

from lerobot_act_chunking.heads.make import HEADS
from lerobot_act_chunking.nn.latents.make import LATENTS
from lerobot_act_chunking.policies.act_chunked.draws import ActingDraws

ACT = {
    "chunk_size": T,
    "dim_model": 16,
    "n_heads": 2,
    "dim_feedforward": 24,
    "n_encoder_layers": 2,
    "n_vae_encoder_layers": 2,
    "latent_dim": 8,
    "dropout": 0.0,
    "vision_backbone": "small_cnn",
}
TWO_LAYERS = {"n_decoder_layers": 2, "actions_per_query": 1, "use_ema": True}  # queries attend to each other
SAMPLED = {
    "use_vae": True,
    "latent_type": "conditional",
    "z_inference": "sample",
    "action_likelihood": "gaussian",
    "action_temperature": 1.0,
}
AUTOREGRESSIVE = {
    "image_tokens": "summary",
    "decoder_type": "autoregressive",
    "actions_per_query": 1,
    "n_decoder_layers": 2,
}


def noise(case: Case, batch_size: int, generator: torch.Generator) -> dict[str, Tensor]:
    if not case.config().is_stochastic:
        return {}
    network = case.policy().model
    return {
        "noise": torch.randn(batch_size, network.latent.n_noise, generator=generator),
        "draws": torch.rand(batch_size, *network.head.draws_shape, generator=generator),
    }


KIND = Kind(ACT, {"dim_model": 32, "dim_feedforward": 64, "use_vae": False}, 160, noise)
CASES = [
    Case("state", "act_chunked", STATE),
    Case("environment", "act_chunked", ENVIRONMENT, TWO_LAYERS),
    Case("vectors", "act_chunked", STATE | VELOCITY | ENVIRONMENT, {"actions_per_query": 5, "use_vae": True}),
    Case("cameras", "act_chunked", TOP | WRIST, {"use_vae": True}),
    Case("mixed", "act_chunked", STATE | TOP, {"preset": "paper"}),
    Case("sampled", "act_chunked", STATE | ENVIRONMENT, SAMPLED),
    Case("autoregressive", "act_chunked", STATE | TOP, AUTOREGRESSIVE),
]

DETERMINISTIC = {"use_vae": False}
DRAWING = {"z_inference": "sample", "use_vae": True}
SAMPLING = [
    Case("sampled", "act_chunked", STATE, DRAWING),
    Case("held latent", "act_chunked", STATE, DRAWING | {"z_hold": "episode"}),
    Case("drawn actions", "act_chunked", STATE, {"action_likelihood": "gaussian", "action_temperature": 1.0}),
]
HISTORY = {"n_obs_steps": 3, "execution": "receding", "use_velocity": True, "replan_interval": 1}
KEPT = [  # what a policy can keep from step to step beside its plan
    Case("frames", "act_chunked", STATE | TOP, HISTORY),
    Case("held latent", "act_chunked", STATE, DRAWING | {"z_hold": "episode"}),
    Case("crossfade", "act_chunked", STATE, {"execution": "crossfade"}),
    Case("adaptive", "act_chunked", STATE, {"execution": "adaptive"}),
]
LONG = [  # chunks longer than some episodes
    Case("act", "act_chunked", STATE, {"chunk_size": 12}),
    Case("strided", "act_chunked", STATE, {"chunk_size": 6, "chunk_stride": 3, "actions_per_query": 2}),
]
_ADAPTED = (
    *({"decoder_type": kind} for kind in ("parallel", "autoregressive")),
    {"decoder_type": "autoregressive", "action_likelihood": "gmm"},
    *({"action_likelihood": kind} for kind in HEADS),
    *({**DRAWING, "latent_type": kind} for kind in LATENTS),
    *({"image_tokens": kind} for kind in ("cells", "summary")),
    {"n_obs_steps": 2, "use_velocity": True},
    {"pre_norm": True},
    {"vision_backbone": "resnet18", "pretrained_backbone_weights": None},
)
ADAPTED = [Case(str(each), "act_chunked", STATE | ENVIRONMENT | TOP, each) for each in _ADAPTED]
WEIGHTED = [(Case("state", "act_chunked", STATE, {"use_vae": True}), "kl_weight")]  # terms of the loss
CHOICES = [("act_chunked", "feedforward_activation", "gelu")]  # of fields that LeRobot's policies have, too
# Without dropout: LeRobot's new data loader draws from the random generator that resuming has just restored.
TRAINED = (
    "--policy.dim_model=16 --policy.n_heads=2 --policy.chunk_size=5 --policy.use_ema=true --policy.dropout=0"
)
_SMALL = {"n_encoder_layers": 1, "actions_per_query": 5, "use_vae": False}
_STYLES = {**_SMALL, "use_vae": True, "z_inference": "sample"}
EXPORTED = [  # the gate exports the first
    Case(
        "history, camera, limits",
        "act_chunked",
        STATE | TOP,
        {
            **_SMALL,
            "n_obs_steps": 2,
            "use_velocity": True,
            "resize_shape": (24, 36),
            "crop_shape": (20, 30),
            "execution": "crossfade",
            "replan_interval": 2,
            "action_limits": "demonstrations",
            "max_speed": 1.0,
        },
    ),
    *(Case(f"head {kind}", "act_chunked", STATE, {**_SMALL, "action_likelihood": kind}) for kind in HEADS),
    *(
        Case(
            f"drawn {kind}",
            "act_chunked",
            STATE,
            {**_SMALL, "action_likelihood": kind, "action_temperature": 1.0},
        )
        for kind in HEADS
        if kind not in ("l1", "l2")
    ),
    *(Case(f"latent {kind}", "act_chunked", STATE, {**_STYLES, "latent_type": kind}) for kind in LATENTS),
    Case("held latent", "act_chunked", STATE, {**_STYLES, "z_hold": "episode"}),
    Case("two cameras", "act_chunked", STATE | TOP | WRIST, _SMALL),
    Case("resnet", "act_chunked", TOP, {"vision_backbone": "resnet18", "pretrained_backbone_weights": None}),
    Case("strided", "act_chunked", STATE | VELOCITY | ENVIRONMENT, {**_SMALL, "chunk_stride": 2}),
    Case("autoregressive", "act_chunked", STATE, AUTOREGRESSIVE | {"image_tokens": "cells"}),
]
SHORT = {  # short chunks, to be evaluated
    "chunk_size": 12,
    "dim_model": 16,
    "n_heads": 2,
    "dim_feedforward": 24,
    "n_encoder_layers": 1,
    "use_vae": False,
}

TINY = {  # for random configurations
    "chunk_size": 6,
    "dim_model": 8,
    "n_heads": 2,
    "dim_feedforward": 12,
    "n_encoder_layers": 1,
    "n_vae_encoder_layers": 1,
    "n_decoder_layers": 1,
    "latent_dim": 3,
    "n_bins": 11,
}
INDIVISIBLE = [
    ("act_chunked", {"chunk_size": 7, "actions_per_query": 2}, "chunk_size", "actions_per_query"),
    ("act_chunked", {"chunk_size": 100, "actions_per_query": 8}, "chunk_size", "actions_per_query"),
    ("act_chunked", {"dim_model": 100}, "dim_model", "n_heads"),
    ("act_chunked", {"dim_model": 10, "n_heads": 3}, "dim_model", "n_heads"),
]
TOO_COSTLY = [
    ("act_chunked", {"dim_model": 2**14, "n_encoder_layers": 50}, "billion weights, more than 4"),
    ("act_chunked", {"chunk_size": 5000, "chunk_stride": 21}, "span 104980 control steps, more than 100000"),
    ("act_chunked", {"n_obs_steps": 400, "obs_stride": 300}, "span 119701 control steps, more than 100000"),
]

COHERENCE = {"execution": "coherence"}
PROVOKED = [  # errors whose text names the way out
    ("act_chunked", {"n_action_steps": 1, "execution": "ensemble"}),
    ("act_chunked", {"temporal_ensemble_coeff": 0.1, "execution": "receding"}),
    ("act_chunked", {"ensemble_weighting": "recency"}),
    ("act_chunked", {"limit_margin": 0.1}),
    ("act_chunked", {"temporal_ensemble_coeff": -0.1, "execution": "ensemble"}),
    (
        "act_chunked",
        {"temporal_ensemble_coeff": 0.1, "ensemble_weighting": "uniform", "execution": "ensemble"},
    ),
    ("act_chunked", {"execution": "open_loop", "replan_interval": 20}),
    ("act_chunked", {"image_tokens": "summary", "n_obs_steps": 2}),
    ("act_chunked", {"use_velocity": True}),
    ("act_chunked", {"history_dropout": 0.1}),
    ("act_chunked", {"execution": "ensemble", **DRAWING, "z_hold": "chunk"}),
    ("act_chunked", COHERENCE),
    ("act_chunked", {**COHERENCE, **DRAWING}),
    ("act_chunked", {"action_temperature": 1.0}),
    ("act_chunked", {"action_likelihood": "categorical", "action_top_k": 3}),
    ("act_chunked", {"use_vae": True, "z_temperature": 0.0}),
    ("act_chunked", {"use_vae": True, "z_hold": "steps"}),
    ("act_chunked", {"use_vae": True, "z_hold_steps": 3}),
    (
        "act_chunked",
        {"pretrained_backbone_weights": "ResNet18_Weights.IMAGENET1K_V1", "backbone_norm": "group"},
    ),
    ("act_chunked", {"vision_backbone": "small_cnn", "pretrained_backbone_weights": "imagenet"}),
    ("act_chunked", {"horizon_s": 2.0, "fps": 50.0, "chunk_size": 30}),
    ("act_chunked", {"n_action_steps": 120}),
]


class Stream:
    """The latents (part 0) or the choices of actions (part 1) that are drawn while acting."""

    def __init__(self, seed, episodes, part, hold_steps=0.0):
        self.part = part
        self.draws = ActingDraws(seed, n_noise=6, draws_shape=(6,), hold_steps=hold_steps, episodes=episodes)

    def reset(self, envs):
        self.draws.reset(envs)

    def draw(self, env):
        return self.draws.draw(1, envs=[env])[self.part][0, 0]


STREAMS = [
    ("latents", lambda *args: Stream(*args, 0)),
    ("held latents", lambda *args: Stream(*args, 0, math.inf)),
    ("choices", lambda *args: Stream(*args, 1)),
]
