"""The whole diagnosis, from what is asked to the report; and the same with a prior fitted on the way."""

from pathlib import Path

from lerobot_act_chunking.diagnostics.core.latents.subject import Subject, load_subject
from lerobot_act_chunking.diagnostics.core.samples import Samples, read_samples
from lerobot_act_chunking.diagnostics.latent.measuring import measure
from lerobot_act_chunking.diagnostics.latent.report import LatentReport
from lerobot_act_chunking.diagnostics.latent.saving import sample_when_acting, save_with_density
from lerobot_act_chunking.diagnostics.latent.settings import Settings


def diagnose(settings: Settings) -> LatentReport:
    """Is the latent in use, and does acting sample styles that were demonstrated?

    Args:
        settings: what is asked.

    Raises:
        ConfigurationError: there is no such checkpoint, or the policy has no latent.
        DatasetError: there is no dataset, it is damaged, or has too few demonstrations.
        FeatureError: it lacks what the policy needs, or has another shape of it.
    """
    subject, samples = _read(settings)
    return measure(subject, samples, settings.thresholds, seed=settings.seed)


def fit_prior(settings: Settings, component_weights: str, folder: Path) -> LatentReport:
    """Diagnose a policy with a prior fitted to the demonstrations, and save it with that prior.

    Args:
        settings: what is asked.
        component_weights: ``empirical`` or ``uniform``, how often acting samples each component.
        folder: the checkpoint to write.

    Raises:
        ConfigurationError: as `diagnose`; the latent learns its prior; or ``folder`` exists.
        DatasetError: as `diagnose`.
        FeatureError: as `diagnose`.
    """
    subject, samples = _read(settings)
    sample_when_acting(subject, component_weights)
    report = measure(subject, samples, settings.thresholds, refit=True, seed=settings.seed)
    assert report.density is not None  # noqa: S101  (only codes have none, and those have been refused)
    save_with_density(subject, report.density, folder)
    return report


def _read(settings: Settings) -> tuple[Subject, Samples]:
    subject = load_subject(settings.checkpoint)
    return subject, read_samples(settings.dataset, subject.config, settings.samples)
