"""Where fast chunks enter LeRobot; see the package's docstring.

LeRobot is imported inside the functions: this module must load with any LeRobot, to say what does not fit.
"""

import inspect
import logging
import os

from lerobot_act_chunking.compat import reader_incompatibility

SWITCH = "ACT_CHUNKING_FAST_CHUNKS"

logger = logging.getLogger(__name__)


def install() -> bool:
    """Makes LeRobot's dataset factory build fast datasets; harmless when repeated.

    Returns:
        Whether it does now. False if the environment switches it off, or if this LeRobot is not the one that
        fast chunks were written for; the latter is logged and leaves LeRobot as it is.
    """
    if os.environ.get(SWITCH) == "0":
        return False
    try:
        reason = _incompatibility()
        if reason is None:
            _replace()
            return True
    except (ImportError, AttributeError) as error:
        reason = str(error)
    logger.warning("fast chunks are off and LeRobot's own reader is used: %s", reason)
    return False


def uninstall() -> None:
    """Gives LeRobot's dataset factory its own names back; harmless when nothing is installed."""
    from lerobot.datasets import factory, lerobot_dataset

    from lerobot_act_chunking.data.fast_chunks.dataset import FastChunkDataset

    if factory.LeRobotDataset is FastChunkDataset:
        factory.LeRobotDataset = lerobot_dataset.LeRobotDataset
        factory.make_dataset = inspect.unwrap(factory.make_dataset)
        factory.resolve_delta_timestamps = inspect.unwrap(factory.resolve_delta_timestamps)


def _replace() -> None:
    from lerobot.datasets import factory

    from lerobot_act_chunking.data.fast_chunks.checks import with_checks
    from lerobot_act_chunking.data.fast_chunks.dataset import FastChunkDataset
    from lerobot_act_chunking.data.fast_chunks.reading import with_reading

    if factory.LeRobotDataset is not FastChunkDataset:
        # All are found before one is replaced.
        make_dataset = with_checks(factory.make_dataset)
        resolve = with_reading(factory.resolve_delta_timestamps)
        factory.LeRobotDataset = FastChunkDataset
        factory.make_dataset, factory.resolve_delta_timestamps = make_dataset, resolve


def _incompatibility() -> str | None:
    """Why fast chunks do not fit in, None if they do."""
    reason = reader_incompatibility()
    if reason is not None:
        return reason
    from lerobot.datasets import factory
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    from lerobot_act_chunking.data.fast_chunks.dataset import FastChunkDataset

    if factory.LeRobotDataset not in (LeRobotDataset, FastChunkDataset):
        return f"LeRobot's dataset factory already builds {factory.LeRobotDataset.__qualname__}"
    return None
