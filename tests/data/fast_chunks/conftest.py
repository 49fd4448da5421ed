"""Small LeRobot datasets with every kind of feature, and LeRobot's own reader to compare with."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import datasets
import pytest
from lerobot.datasets import factory
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot_sets import NUMBERS, REPO_ID, STATES, camera, record

from lerobot_act_chunking.data import fast_chunks
from lerobot_act_chunking.data.fast_chunks.dataset import FastChunkDataset


@pytest.fixture(scope="session", autouse=True)
def quiet_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterable[None]:
    """Arrow copies of the test datasets go to a temporary folder, without progress bars."""
    patch = pytest.MonkeyPatch()
    patch.setattr(datasets.config, "HF_DATASETS_CACHE", tmp_path_factory.mktemp("arrow"))
    datasets.disable_progress_bars()
    yield
    datasets.enable_progress_bars()
    patch.undo()


@pytest.fixture(scope="session")
def numbers(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every kind of number and a text, in several parquet files."""
    return record(tmp_path_factory.mktemp("numbers") / "set", NUMBERS, data_files_size_in_mb=0.001)


@pytest.fixture(scope="session")
def states(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a state policy learns from: numbers only."""
    return record(tmp_path_factory.mktemp("states") / "set", STATES)


@pytest.fixture(scope="session")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two cameras of different shapes and a depth map, stored as images."""
    features = {
        "observation.images.top": camera("image", 8, 12),
        "observation.images.side": camera("image", 6, 10),
        "observation.images.depth": camera("image", 6, 10, 1, is_depth_map=True),
        **STATES,
    }
    return record(tmp_path_factory.mktemp("images") / "set", features, use_videos=False)


@pytest.fixture(scope="session")
def videos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two cameras stored as videos."""
    features = {
        "observation.images.top": camera("video", 64, 96),
        **STATES,
        "observation.images.side": camera("video", 64, 80),
    }
    return record(tmp_path_factory.mktemp("videos") / "set", features)


@pytest.fixture(scope="session")
def open_both() -> Callable[..., tuple[FastChunkDataset, LeRobotDataset]]:
    """Opens a dataset twice: fast, and by LeRobot."""

    def open_pair(root: Path, **options: Any) -> tuple[FastChunkDataset, LeRobotDataset]:
        options = {"video_backend": "pyav", **options}
        return FastChunkDataset(REPO_ID, root, **options), LeRobotDataset(REPO_ID, root, **options)

    return open_pair


@pytest.fixture
def stock_factory() -> Iterable[None]:
    """LeRobot's own factory, as it is before the plugin is discovered."""
    installed = factory.LeRobotDataset is FastChunkDataset
    fast_chunks.uninstall()
    yield
    fast_chunks.uninstall()
    if installed:
        fast_chunks.install()
