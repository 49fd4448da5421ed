"""The whole diagnosis, from what is asked to the report."""

from collections.abc import Callable

from lerobot_act_chunking.diagnostics.smoothness.comparison import compare
from lerobot_act_chunking.diagnostics.smoothness.report import SmoothnessComparison
from lerobot_act_chunking.diagnostics.smoothness.settings import Settings


def diagnose(settings: Settings, progress: Callable[[str, int], None] | None = None) -> SmoothnessComparison:
    """How smooth is what policies command, and what robots make of it?

    Args:
        settings: what is asked.
        progress: called with a checkpoint's name and its number of finished episodes.

    Raises:
        ConfigurationError: no such checkpoint, or a replan interval without a dataset.
        DatasetError: a folder with neither checkpoint nor dataset, or fewer than two episodes.
        FeatureError: the sources move different joints, or a policy for another robot.
    """
    reports = compare(
        settings.sources, settings.evaluation, replan_interval=settings.replan_interval, progress=progress
    )
    return SmoothnessComparison(requested=settings, sources=reports)
