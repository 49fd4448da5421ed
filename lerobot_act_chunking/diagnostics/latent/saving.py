"""A checkpoint whose acting samples the fitted density, beside the one that it is made from."""

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import torch

from lerobot_act_chunking.diagnostics.core.latents.subject import Subject
from lerobot_act_chunking.diagnostics.latent.density import Density
from lerobot_act_chunking.errors import ConfigurationError, unknown_choice
from lerobot_act_chunking.nn.latents.gaussian import GaussianLatent
from lerobot_act_chunking.nn.latents.spec import COMPONENT_WEIGHTS
from lerobot_act_chunking.policies.loading import LoadedPolicy
from lerobot_act_chunking.policies.saving import save_checkpoint

TRAINING = "train_config.json"


@dataclass(frozen=True)
class _TrainingConfig:
    """The configuration of the training, which goes with the weights."""

    checkpoint: str

    def save_pretrained(self, folder: Path) -> None:
        file = Path(self.checkpoint) / TRAINING
        if file.exists():
            shutil.copyfile(file, folder / TRAINING)


def sample_when_acting(subject: Subject, component_weights: str) -> None:
    """Let the policy sample its latent, components as often as told.

    Raises:
        ConfigurationError: there are no such weights, its latent has a learned prior, or its other settings
            rule sampling out.
    """
    from lerobot.configs import PreTrainedConfig

    if component_weights not in COMPONENT_WEIGHTS:
        raise unknown_choice("component_weights", component_weights, COMPONENT_WEIGHTS)
    if not isinstance(subject.latent, GaussianLatent):
        raise ConfigurationError(
            f"latent_type={subject.config.latent_type} learns its prior in training: a density can be fitted "
            "to a gaussian latent only (act-chunking latent shows what this one does)"
        )
    acting = {"z_inference": "sample", "prior_component_weights": component_weights}
    subject.loaded.policy.config = PreTrainedConfig.from_pretrained(
        subject.checkpoint, cli_overrides=[f"--{name}={value}" for name, value in acting.items()]
    )
    for latent in _latents(subject):
        latent.uniform = subject.config.latent_spec.uniform


def save_with_density(subject: Subject, density: Density, folder: Path) -> None:
    """Write the policy with this density as a checkpoint: complete under its name, or not at all.

    Raises:
        ConfigurationError: ``folder`` exists, or the disk does not take it.
    """
    values = (torch.from_numpy(each).float() for each in (density.weights, density.means, density.scales))
    weights, means, scales = values
    for latent in _latents(subject):
        latent.fit_density(weights, means, scales)
    parts = (*subject.loaded, _TrainingConfig(subject.checkpoint))
    save_checkpoint(cast("LoadedPolicy", parts), folder)


def _latents(subject: Subject) -> list[GaussianLatent]:
    """Of the trained network, and of the averaged one."""
    policy = subject.loaded.policy
    networks = [policy.model] if policy.ema is None else [policy.model, policy.ema.network]
    return [network.latent for network in networks]
