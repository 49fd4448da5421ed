"""Everything that a latent is built from."""

from dataclasses import dataclass, fields
from typing import Any

from lerobot_act_chunking.errors import unknown_choice
from lerobot_act_chunking.ranges import RANGES, check_ranges

COMPONENT_WEIGHTS = ("empirical", "uniform")


@dataclass(frozen=True, kw_only=True)
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

    latent_type: str
    latent_dim: int
    n_latent_components: int
    latent_warmup_steps: int
    prior_component_weights: str
    z_temperature: float

    @classmethod
    def from_fields(cls, source: Any) -> "LatentSpec":
        """The spec whose values are the attributes of ``source``, a policy's configuration."""
        return cls(**{field.name: getattr(source, field.name) for field in fields(cls)})

    @property
    def uniform(self) -> bool:
        """Whether components and codes are sampled equally often."""
        return self.prior_component_weights == "uniform"

    def check_values(self) -> None:
        """Refuse values that cannot work, whatever the type.

        Raises:
            ConfigurationError: naming the value and the way out.
        """
        if self.prior_component_weights not in COMPONENT_WEIGHTS:
            raise unknown_choice("prior_component_weights", self.prior_component_weights, COMPONENT_WEIGHTS)
        check_ranges(self, *(field.name for field in fields(self) if field.name in RANGES))
