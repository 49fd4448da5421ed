"""The whole diagnosis, from what is asked to the report."""

from lerobot_act_chunking.data.actions import is_dataset
from lerobot_act_chunking.diagnostics.core.episodes import read_episodes
from lerobot_act_chunking.diagnostics.resolution.measuring import measure
from lerobot_act_chunking.diagnostics.resolution.report import ResolutionReport
from lerobot_act_chunking.diagnostics.resolution.settings import Settings
from lerobot_act_chunking.errors import DatasetError


def diagnose(settings: Settings) -> ResolutionReport:
    """How far apart may predictions lie for these demonstrations?

    Args:
        settings: what is asked.

    Raises:
        ConfigurationError: a question that cannot be answered, naming the value.
        DatasetError: there is no dataset, it is damaged, or no episode is as long as a chunk.
    """
    if not is_dataset(settings.dataset):
        raise DatasetError(
            f"there is no LeRobotDataset at {settings.dataset}: give its folder (with meta/info.json)"
        )
    return measure(read_episodes(settings.dataset), settings.question)
