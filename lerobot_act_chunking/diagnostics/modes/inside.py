"""What was found inside of a policy: its latent or its codes, way by way."""

from dataclasses import dataclass
from typing import Any

from lerobot_act_chunking.diagnostics.modes.frequencies import Frequencies
from lerobot_act_chunking.diagnostics.modes.settings import Thresholds


@dataclass(frozen=True)
class LatentModes:
    """A latent, as decoded chunks show it.

    Attributes:
        kl: mean divergence of the posteriors from the prior [nats].
        active_units: dimensions of the posteriors' means that depend on the demonstration.
        errors: of each way, mean absolute error of chunks decoded from their own posterior [normalised
            units]; None where there is no demonstration.
        reconstructed: of each way, share of these chunks that go it.
        prior: ways of chunks from the prior.
        posterior: ways of chunks from the aggregated posterior: from other demonstrations' styles.
        likeliest: ways of chunks from the prior's mode, which is z = 0 for a gaussian one.
        fitted: whether the prior was fitted after training.
    """

    kl: float
    active_units: int
    errors: list[float | None]
    reconstructed: list[float | None]
    prior: Frequencies
    posterior: Frequencies
    likeliest: Frequencies
    fitted: bool = False

    def to_json(self, thresholds: Thresholds) -> dict[str, Any]:
        """Plain numbers and lists."""
        kinds = {"prior": self.prior, "posterior": self.posterior, "likeliest": self.likeliest}
        return {
            "kl": self.kl,
            "active_units": self.active_units,
            "errors": self.errors,
            "reconstructed": self.reconstructed,
            "fitted": self.fitted,
            **{name: each.to_json(thresholds) for name, each in kinds.items()},
        }


@dataclass(frozen=True)
class CodeModes:
    """A tokenizer's codes.

    Attributes:
        used: of each way, how many different combinations of codes its demonstrations have at the start.
        shared: combinations that demonstrations of several ways have.
        reconstructed: of each way, share of its demonstrations whose codes alone go it.
    """

    used: list[int]
    shared: int
    reconstructed: list[float | None]

    def to_json(self, thresholds: Thresholds) -> dict[str, Any]:
        """Plain numbers and lists."""
        return dict(vars(self))


type Inside = LatentModes | CodeModes
