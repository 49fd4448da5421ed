"""What benchmarks/diffusion_success.py trains, and how it lets it act."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from policy_study import Run
from policy_training import Variant

RECIPE: dict[str, Any] = yaml.safe_load((Path(__file__).parents[1] / "configs/diffusion.yaml").read_text())
SEEDS = (0, 1, 2)
EARLY = "000400"
"""The checkpoint after a fifth of the training, where success is not saturated."""
STEPS = (1, 2, 3, 5, 10, 20)


def ours(steps: int = RECIPE["steps"], **changes: Any) -> Variant:
    """The recipe but for these settings."""
    return Variant({**RECIPE["policy"], **changes}, steps, RECIPE["batch_size"])


# What a core leaves time for: a small U-Net, 10 DDIM steps instead of DDPM's 100, and a warm-up that is
# shorter than the training.
LEROBOT = {
    "type": "diffusion",
    "device": "cpu",
    "push_to_hub": False,
    "down_dims": [64, 128, 256],
    "noise_scheduler_type": "DDIM",
    "num_inference_steps": 10,
    "optimizer_lr": 1e-3,
    "scheduler_warmup_steps": 33,
}

VARIANTS = {
    "recipe": ours(),
    "prefix": ours(prefix_steps=10),
    "uniform_times": ours(time_distribution="uniform"),
    "velocity": ours(prediction_type="velocity"),
    "every_step": ours(horizon=100, chunk_stride=1, actions_per_token=5),
    "two_step": ours(objective="two_step", num_inference_steps=2),
    "ddpm_epsilon": ours(objective="ddpm", num_inference_steps=10),
    "dit": ours(900, denoiser="dit", n_heads=4),
    "unet1d": ours(750, denoiser="unet1d", unet_size="S"),
    "lerobot_small": Variant(LEROBOT, 330, RECIPE["batch_size"]),
}


def recipe(task: str) -> Iterator[Run]:
    """The headline: three training seeds."""
    for seed in SEEDS:
        yield Run(task, "recipe", seed)


def against_lerobot(task: str) -> Iterator[Run]:
    """LeRobot's `diffusion` on the same data, for as long."""
    yield Run(task, "lerobot_small")


def variants(task: str) -> Iterator[Run]:
    """One setting changed at a time."""
    for name, variant in VARIANTS.items():
        if name != "recipe" and not variant.is_lerobot:
            yield Run(task, name)


def steps(task: str) -> Iterator[Run]:
    """Samplers and their steps; of flow matching also from the half-trained checkpoint."""
    sweeps = {
        ("recipe", EARLY): {"euler": STEPS, "heun": (3, 5)},
        ("recipe", "last"): {"euler": STEPS},
        ("ddpm_epsilon", "last"): {"ddim": STEPS[1:], "dpm++": (5, 10), "ddpm": (10, 20)},
    }
    for (variant, checkpoint), samplers in sweeps.items():
        for sampler, counts in samplers.items():
            for count in counts:
                sampling = {"sampler": sampler, "num_inference_steps": count}
                yield Run(task, variant, 0, checkpoint, sampling)


STUDIES = {"recipe": recipe, "lerobot": against_lerobot, "variants": variants, "steps": steps}
