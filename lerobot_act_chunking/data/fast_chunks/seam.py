"""Where fast chunks enter LeRobot; see the package's docstring.

LeRobot is imported inside the functions: this module must load with any LeRobot, to say what does not fit.
"""

import inspect
import logging
import os

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
        misfit = _misfit()
        if misfit is None:
            _replace()
            return True
    except (ImportError, AttributeError) as error:
        misfit = str(error)
    logger.warning("fast chunks are off and LeRobot's own reader is used: %s", misfit)
    return False


def uninstall() -> None:
    """Gives LeRobot's dataset factory its own names back; harmless when nothing is installed."""
    from lerobot.datasets import factory, lerobot_dataset

    from lerobot_act_chunking.data.fast_chunks.dataset import FastChunkDataset

    if factory.LeRobotDataset is FastChunkDataset:
        factory.LeRobotDataset = lerobot_dataset.LeRobotDataset
        factory.make_dataset = inspect.unwrap(factory.make_dataset)


def _replace() -> None:
    from lerobot.datasets import factory

    from lerobot_act_chunking.data.fast_chunks.checks import with_checks
    from lerobot_act_chunking.data.fast_chunks.dataset import FastChunkDataset

    if factory.LeRobotDataset is not FastChunkDataset:
        factory.LeRobotDataset = FastChunkDataset
        factory.make_dataset = with_checks(factory.make_dataset)


def _misfit() -> str | None:
    """In what LeRobot differs from the 0.6.1 whose insides are used here, None if it does not."""
    from datasets import Dataset
    from lerobot.datasets import factory
    from lerobot.datasets.dataset_reader import DatasetReader
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    from lerobot_act_chunking.data.fast_chunks.dataset import FastChunkDataset

    if factory.LeRobotDataset not in (LeRobotDataset, FastChunkDataset):
        return f"LeRobot's dataset factory already builds {factory.LeRobotDataset.__qualname__}"
    if hasattr(LeRobotDataset, "__getitems__"):
        return "LeRobotDataset has a __getitems__ of its own"
    used = {
        LeRobotDataset.__init__: ("reader", "writer"),
        DatasetReader.__init__: ("hf_dataset", "delta_indices", "_absolute_to_relative_idx", "_meta"),
        DatasetReader.get_item: ("hf_dataset", "delta_indices", "_query_hf_dataset", "_get_query_timestamps"),
        Dataset.__init__: ("_format_kwargs",),
    }
    for function, names in used.items():
        for name in names:
            if name not in function.__code__.co_names:
                return f"{function.__qualname__} has no {name}"
    return None
