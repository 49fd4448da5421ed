"""From a latent's name to the latent."""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

from lerobot_act_chunking.errors import ConfigurationError, unknown_choice
from lerobot_act_chunking.nn.latents.categorical import CategoricalLatent
from lerobot_act_chunking.nn.latents.conditional import ConditionalLatent
from lerobot_act_chunking.nn.latents.gaussian import GaussianLatent
from lerobot_act_chunking.nn.latents.latent import Latent
from lerobot_act_chunking.nn.latents.mixture import MixtureLatent

COMPONENT_WEIGHTS = ("empirical", "uniform")


@dataclass(frozen=True)
class LatentSpec:
    """What a style is. Only the settings of the named type count.

    Attributes:
        latent_type: ``gaussian`` (ACT: prior N(0, I), or a density fitted after training), ``conditional``
            (a prior that depends on the observation), ``mixture`` (a learned prior of several components) or
            ``categorical`` (one of several codes).
        latent_dim: numbers in a style; of ``categorical``, there is one for each code instead.
        n_latent_components: components of ``mixture``, codes of ``categorical``.
        latent_warmup_steps: training steps until ``mixture`` places its components, or over which
            ``categorical`` hardens its samples.
        prior_component_weights: how often acting samples the components (of a fitted density and of
            ``mixture``) or the used codes: ``empirical`` as they occur, ``uniform`` all equally often.
        z_temperature: above 0; 1 samples as learned, below 1 closer to what is likeliest.
    """

    latent_type: str = "gaussian"
    latent_dim: int = 32
    n_latent_components: int = 8
    latent_warmup_steps: int = 1000
    prior_component_weights: str = "empirical"
    z_temperature: float = 1.0

    @classmethod
    def from_fields(cls, source: Any) -> "LatentSpec":
        """The spec whose values are the attributes of ``source``, a policy's configuration."""
        return cls(**{field.name: getattr(source, field.name) for field in fields(cls)})

    @property
    def uniform(self) -> bool:
        """Whether components and codes are sampled equally often."""
        return self.prior_component_weights == "uniform"

    def check(self) -> None:
        """Refuse values that cannot work.

        Raises:
            ConfigurationError: naming the value and the way out.
        """
        if self.latent_type not in LATENTS:
            raise unknown_choice("latent_type", self.latent_type, LATENTS)
        if self.prior_component_weights not in COMPONENT_WEIGHTS:
            raise unknown_choice("prior_component_weights", self.prior_component_weights, COMPONENT_WEIGHTS)
        for name, least in (("latent_dim", 1), ("n_latent_components", 2), ("latent_warmup_steps", 1)):
            if getattr(self, name) < least:
                raise ConfigurationError(f"{name}={getattr(self, name)} must be at least {least}")
        if not 0 < self.z_temperature < math.inf:
            raise ConfigurationError(
                f"z_temperature={self.z_temperature} must be above 0 and finite: set z_temperature=1, with "
                "z_inference=mode for the likeliest style alone"
            )


LATENTS: dict[str, Callable[[LatentSpec, int], Latent]] = {
    "gaussian": lambda spec, dim: GaussianLatent(
        spec.latent_dim, temperature=spec.z_temperature, uniform=spec.uniform
    ),
    "conditional": lambda spec, dim: ConditionalLatent(spec.latent_dim, dim, temperature=spec.z_temperature),
    "mixture": lambda spec, dim: MixtureLatent(
        spec.latent_dim,
        spec.n_latent_components,
        warmup_steps=spec.latent_warmup_steps,
        temperature=spec.z_temperature,
        uniform=spec.uniform,
    ),
    "categorical": lambda spec, dim: CategoricalLatent(
        spec.n_latent_components,
        anneal_steps=spec.latent_warmup_steps,
        temperature=spec.z_temperature,
        uniform=spec.uniform,
    ),
}


def make_latent(spec: LatentSpec, dim: int) -> Latent:
    """A fresh latent for a policy whose tokens have ``dim`` channels.

    Raises:
        ConfigurationError: naming a value that cannot work.
    """
    spec.check()
    return LATENTS[spec.latent_type](spec, dim)
