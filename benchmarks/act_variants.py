"""What benchmarks/act_success.py trains, and how it lets it act."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from policy_study import Run
from policy_training import Variant

RECIPE: dict[str, Any] = yaml.safe_load((Path(__file__).parents[1] / "configs/quickstart.yaml").read_text())
# Blended as the default was when the published figures were measured.
POLICY = {**RECIPE["policy"], "execution": "crossfade", "crossfade_steps": 10}
STEPS, BATCH = RECIPE["steps"], RECIPE["batch_size"]
ON_CPU = {"device": "cpu", "push_to_hub": False}
SIZE = {name: POLICY[name] for name in ("dim_model", "n_heads", "n_encoder_layers", "optimizer_lr")}
SEEDS = (0, 1, 2)


def small(**changes: Any) -> Variant:
    """The quickstart's policy but for these settings, trained half as long."""
    return Variant({**POLICY, **changes}, STEPS // 2, BATCH)


def styled(**changes: Any) -> Variant:
    """The same with a latent style; two layers see it."""
    weights = {"use_vae": True, "n_vae_encoder_layers": 2, "vae_action_stride": 5, "kl_weight": 0.01}
    return small(**{**weights, "free_bits": 0.05, "latent_warmup_steps": 500, **changes})


# LeRobot's own, for about as many minutes: as it comes, and as benchmarks/quickstart.py has it
LEROBOT = {"type": "act", **ON_CPU}
LEROBOT_SMALL = {
    **LEROBOT,
    **SIZE,
    "dim_feedforward": 512,
    "use_vae": False,
    "dropout": 0,
    "n_action_steps": 50,
}

HEADLINE = {
    "base": Variant({"type": "act_chunked", **ON_CPU}, 1200, BATCH),
    "lerobot_small": Variant(LEROBOT_SMALL, 600, BATCH, fast_reader=True),
    "lerobot_own_reader": Variant(LEROBOT_SMALL, 700, BATCH),
    "lerobot_default": Variant(LEROBOT, 80, 8, fast_reader=True),
}

LIKELIHOODS = {
    "l1": small(),
    **{name: small(action_likelihood=name) for name in ("l2", "laplace", "gaussian", "gmm", "categorical")},
    **{f"{name}_nll": small(action_likelihood=name, nll_beta=0) for name in ("laplace", "gmm")},
}

DECODERS = {
    "four_layers": small(n_decoder_layers=4),
    "autoregressive_5": small(decoder_type="autoregressive"),
    "autoregressive_10": small(decoder_type="autoregressive", actions_per_query=10),
}

LATENTS = {
    "style_gaussian": styled(),
    "style_conditional": styled(latent_type="conditional"),
    "style_mixture": styled(latent_type="mixture"),
    "style_categorical": styled(latent_type="categorical"),
}

RESOLUTION = {"every_fifth_step": small(chunk_size=20, chunk_stride=5, actions_per_query=1)}

HISTORY = {
    "two_observations": small(n_obs_steps=2, obs_stride=5),
    "velocity": small(n_obs_steps=2, obs_stride=5, use_velocity=True),
}

PRESETS = {
    "autoregressive": Variant(
        {"type": "act_chunked", "preset": "autoregressive", **ON_CPU, **SIZE}, STEPS // 2, BATCH
    ),
    "paper": Variant(
        {"type": "act_chunked", "preset": "paper", **ON_CPU, **SIZE, "dim_feedforward": 512}, 700, BATCH
    ),
}

VARIANTS = {**HEADLINE, **LIKELIHOODS, **DECODERS, **LATENTS, **RESOLUTION, **HISTORY, **PRESETS}


def headline(task: str) -> Iterator[Run]:
    """Preset `base` as it comes: three training seeds."""
    for seed in SEEDS:
        yield Run(task, "base", seed)


def lerobot(task: str) -> Iterator[Run]:
    """LeRobot's `act` on the same data: for as many minutes, and through its own reader for longer."""
    for name in ("lerobot_small", "lerobot_default", "lerobot_own_reader"):
        yield Run(task, name)


def likelihoods(task: str) -> Iterator[Run]:
    """How actions are predicted and scored."""
    for name in LIKELIHOODS:
        yield Run(task, name)


def decoders(task: str) -> Iterator[Run]:
    """What the actions of a chunk know of each other."""
    for name in DECODERS:
        yield Run(task, name)


def latents(task: str) -> Iterator[Run]:
    """Priors of the style, each acting with its mode and with samples."""
    for name in LATENTS:
        yield Run(task, name)
        yield Run(task, name, sampling={"z_inference": "sample"})


def resolution(task: str) -> Iterator[Run]:
    """Fewer predictions for the same two seconds."""
    for name in RESOLUTION:
        yield Run(task, name)


def history(task: str) -> Iterator[Run]:
    """What the policy sees of the past."""
    for name in HISTORY:
        yield Run(task, name)


def presets(task: str) -> Iterator[Run]:
    """The other presets, at the quickstart's size."""
    for name in PRESETS:
        yield Run(task, name)


STUDIES = {
    each.__name__: each
    for each in (headline, lerobot, likelihoods, decoders, latents, resolution, history, presets)
}
