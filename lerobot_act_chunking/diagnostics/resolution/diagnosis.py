"""The whole diagnosis, from what is asked to the report."""

from lerobot_act_chunking.diagnostics.core.episodes import read_episodes
from lerobot_act_chunking.diagnostics.resolution.measuring import measure
from lerobot_act_chunking.diagnostics.resolution.report import ResolutionReport
from lerobot_act_chunking.diagnostics.resolution.settings import Settings


def diagnose(settings: Settings) -> ResolutionReport:
    """How far apart may predictions lie for these demonstrations?

    Args:
        settings: what is asked.

    Raises:
        ConfigurationError: criteria that no stride can meet, naming the value.
        DatasetError: the dataset is damaged, or no episode is as long as a chunk.
    """
    return measure(read_episodes(settings.dataset), settings.criteria)
