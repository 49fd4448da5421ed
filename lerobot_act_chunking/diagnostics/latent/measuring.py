"""From a policy and demonstrations to a `LatentReport`."""

from copy import deepcopy

import numpy as np
import torch
from jaxtyping import Float, Int64

from lerobot_act_chunking.diagnostics.core.latents.encoding import Encoded, encode, reconstruct
from lerobot_act_chunking.diagnostics.core.latents.subject import Subject
from lerobot_act_chunking.diagnostics.core.report import with_untrained
from lerobot_act_chunking.diagnostics.core.samples import Samples
from lerobot_act_chunking.diagnostics.core.training import hardly_learned, untrained
from lerobot_act_chunking.diagnostics.latent.density import Density, fit_density, with_density
from lerobot_act_chunking.diagnostics.latent.figures import check_prior, measure_groups, measure_health
from lerobot_act_chunking.diagnostics.latent.report import FITTED, LEARNED, STANDARD, LatentReport
from lerobot_act_chunking.diagnostics.latent.settings import Thresholds
from lerobot_act_chunking.diagnostics.latent.verdict import Measurements, judge
from lerobot_act_chunking.nn.latents.categorical import CategoricalLatent
from lerobot_act_chunking.nn.latents.gaussian import GaussianLatent

DECODED = 1024
"""Samples that are decoded, from every source of styles."""


def measure(
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
    reconstruction = reconstruct(subject, samples.every(step), decoded, seed=seed)
    errors = reconstruction.errors
    means = {name: float(each.mean()) for name, each in errors.items()}
    groups = measure_groups(of_samples, n_groups, of_samples[::step], errors["posterior"])
    health = measure_health(encoded, samples.progress)
    check = next(prior for prior in priors if prior.name == acting)
    measured = Measurements(subject.config, health, means, check, groups, is_fitted=acting == FITTED)
    message = untrained(subject.checkpoint) or hardly_learned(
        subject.checkpoint, means["posterior"], reconstruction.baseline
    )
    judgement = with_untrained(judge(measured, thresholds), message)
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
        judgement=judgement,
    )


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
