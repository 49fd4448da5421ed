"""Everything the diagnosis found, as one object: the command prints it, JSON holds it, plots draw it."""

from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from lerobot_act_chunking.diagnostics.core.latents.encoding import Encoded
from lerobot_act_chunking.diagnostics.core.latents.subject import Subject
from lerobot_act_chunking.diagnostics.core.report import Report
from lerobot_act_chunking.diagnostics.core.samples import Samples
from lerobot_act_chunking.diagnostics.latent.density import Density
from lerobot_act_chunking.diagnostics.latent.figures import Group, Health, PriorCheck
from lerobot_act_chunking.diagnostics.latent.settings import Thresholds
from lerobot_act_chunking.diagnostics.latent.verdict import LatentJudgement

STANDARD, FITTED, LEARNED = "N(0, I)", "fitted density", "prior"


@dataclass(frozen=True, kw_only=True)
class LatentReport(Report):
    """The answer to: is the latent in use, and does acting sample demonstrated styles?

    Attributes:
        subject: the policy.
        samples: the demonstrations.
        encoded: these in the latent space.
        density: mixture that follows them; None where styles are codes.
        health: of the posteriors.
        errors: mean absolute error [normalised units] by where the style is from.
        priors: all priors looked at.
        drawn: (N, L) samples of each, by name.
        acting: name of the one that acting samples.
        groups: of the demonstrations.
    """

    tool: ClassVar[str] = "latent"
    subject: Subject
    samples: Samples
    encoded: Encoded
    density: Density | None
    health: Health
    errors: dict[str, float]
    priors: list[PriorCheck]
    drawn: dict[str, Float[np.ndarray, "N L"]]
    acting: str
    groups: list[Group]
    thresholds: Thresholds
    judgement: LatentJudgement

    def content(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dictionaries; None for what was not or cannot be measured."""
        config, density = self.subject.config, self.density
        return {
            "checkpoint": self.subject.checkpoint,
            "latent_type": config.latent_type,
            "z_inference": config.z_inference,
            "kl_weight": config.kl_weight,
            "dataset": self.samples.folder,
            "n_samples": len(self.samples),
            "diagnosis": self.judgement.diagnosis,
            "verdict": self.verdict,
            "reasons": self.reasons,
            "thresholds": asdict(self.thresholds),
            "kl": self.health.kl,
            "kl_by_dimension": self.health.kl_by_dimension,
            "kl_active_dims": self.health.kl_active_dims,
            "active_units": self.health.active_units,
            "mean_variance": self.health.mean_variance,
            "by_place": self.health.by_place,
            "reconstruction_error": self.errors,
            "acting": self.acting,
            "priors": [asdict(check) for check in self.priors],
            "groups": [asdict(group) for group in self.groups],
            "density": density and {"components": len(density.weights), "bic": density.bic},
        }
