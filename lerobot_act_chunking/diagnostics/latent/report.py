"""Everything the diagnosis found, as one object: the command prints it, JSON holds it, plots draw it."""

from copy import deepcopy
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int64

from lerobot_act_chunking.diagnostics.core.outcome import EXIT_CODES, with_untrained, write_json
from lerobot_act_chunking.diagnostics.core.training import untrained
from lerobot_act_chunking.diagnostics.latent.density import Density, fit_density
from lerobot_act_chunking.diagnostics.latent.encoding import Encoded, encode, reconstruction_errors
from lerobot_act_chunking.diagnostics.latent.measures import (
    Group,
    Health,
    PriorCheck,
    check_prior,
    measure_groups,
    measure_health,
)
from lerobot_act_chunking.diagnostics.latent.samples import Samples
from lerobot_act_chunking.diagnostics.latent.subject import Subject
from lerobot_act_chunking.diagnostics.latent.verdict import Evidence, Judgement, Thresholds, judge
from lerobot_act_chunking.nn.latents.categorical import CategoricalLatent
from lerobot_act_chunking.nn.latents.gaussian import GaussianLatent

DECODED = 1024
"""Samples that are decoded, from every source of styles."""
STANDARD, FITTED, LEARNED = "N(0, I)", "fitted density", "prior"


@dataclass(frozen=True)
class LatentReport:
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
    judgement: Judgement

    @property
    def exit_code(self) -> int:
        """Of the command, as `EXIT_CODES` has it."""
        return EXIT_CODES[self.judgement.verdict]

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dictionaries."""
        config, density = self.subject.config, self.density
        return {
            "tool": "latent",
            "version": version("lerobot_policy_act_chunking"),
            "checkpoint": self.subject.checkpoint,
            "latent_type": config.latent_type,
            "z_inference": config.z_inference,
            "kl_weight": config.kl_weight,
            "dataset": self.samples.folder,
            "n_samples": len(self.samples),
            "diagnosis": self.judgement.diagnosis,
            "verdict": self.judgement.verdict,
            "reasons": self.judgement.reasons,
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

    def write_json(self, path: Path) -> Path:
        """Write `to_json` to a file, creating its folder."""
        return write_json(self.to_json(), path)


def diagnose(
    subject: Subject, samples: Samples, thresholds: Thresholds, *, refit: bool = False, seed: int = 0
) -> LatentReport:
    """Encode demonstrations, sample priors, decode both, and say what is wrong.

    Args:
        subject: the policy.
        samples: demonstrations, best those it was trained on.
        thresholds: when to worry.
        refit: judge a density fitted now, as if the policy acted with it, in place of the policy's prior.
        seed: of everything random.

    Raises:
        DatasetError: too few demonstrations.
    """
    encoded = encode(subject, samples, seed=seed)
    coded = isinstance(subject.latent, CategoricalLatent)
    density = None if coded else fit_density(encoded.z, seed=seed)
    drawn, acting = _draw_priors(subject, encoded, density, refit=refit, seed=seed)
    of_samples, n_groups = _group(encoded.z, density), _n_groups(encoded, density)
    priors = [
        check_prior(name, z, encoded, samples, (of_samples, _group(z, density), n_groups))
        for name, z in drawn.items()
    ]
    step = -(-len(samples) // DECODED)
    styles = {"posterior": encoded.z, "shuffled": _shuffled(encoded.z, seed), "mode": encoded.mode} | drawn
    decoded = {name: z[::step] for name, z in styles.items()}
    errors = reconstruction_errors(subject, samples.every(step), decoded, seed=seed)
    means = {name: float(each.mean()) for name, each in errors.items()}
    groups = measure_groups(of_samples, n_groups, of_samples[::step], errors["posterior"])
    health = measure_health(encoded, samples.progress)
    check = next(prior for prior in priors if prior.name == acting)
    evidence = Evidence(subject.config, health, means, check, groups, is_fitted=acting == FITTED)
    judgement = judge(evidence, thresholds)
    verdict, reasons = with_untrained(judgement.verdict, judgement.reasons, untrained(subject.checkpoint))
    return LatentReport(
        subject=subject,
        samples=samples,
        encoded=encoded,
        density=density,
        health=health,
        errors=means,
        priors=priors,
        drawn=drawn,
        acting=acting,
        groups=groups,
        thresholds=thresholds,
        judgement=Judgement(judgement.diagnosis, verdict, reasons),
    )


def with_density(latent: GaussianLatent, density: Density) -> GaussianLatent:
    """A latent like this one that samples from the density."""
    fitted = GaussianLatent(latent.dim, temperature=latent.temperature, uniform=latent.uniform)
    fitted.fit_density(
        *(torch.from_numpy(each).float() for each in (density.weights, density.means, density.scales))
    )
    return fitted


def _draw_priors(
    subject: Subject, encoded: Encoded, density: Density | None, *, refit: bool, seed: int
) -> tuple[dict[str, Float[np.ndarray, "N L"]], str]:
    """Samples of all priors that the policy has or could have, and which one it acts with."""
    latent, n = subject.latent, len(encoded.z)
    if not isinstance(latent, GaussianLatent) or density is None:
        return {LEARNED: encoded.prior}, LEARNED
    standard = GaussianLatent(latent.dim, temperature=latent.temperature)
    fitted = deepcopy(latent).cpu() if latent.fitted and not refit else with_density(latent, density)
    noise = torch.randn(n, latent.n_noise, generator=torch.Generator().manual_seed(seed + 1))
    tokens = torch.zeros(n, 1, 1)
    drawn = {
        name: prior.prior(noise, tokens).double().numpy()
        for name, prior in ((STANDARD, standard), (FITTED, fitted))
    }
    return drawn, FITTED if refit or latent.fitted else STANDARD


def _group(z: Float[np.ndarray, "N L"], density: Density | None) -> Int64[np.ndarray, " N"]:
    """The component that a style comes from, or the code that it is."""
    return z.argmax(1) if density is None else density.assign(z)


def _n_groups(encoded: Encoded, density: Density | None) -> int:
    return encoded.z.shape[1] if density is None else len(density.weights)


def _shuffled(z: Float[np.ndarray, "N L"], seed: int) -> Float[np.ndarray, "N L"]:
    """Everyone gets someone else's style."""
    order = np.random.default_rng(seed).permutation(len(z))
    shuffled = np.empty_like(z)
    shuffled[order] = z[np.roll(order, 1)]
    return shuffled
