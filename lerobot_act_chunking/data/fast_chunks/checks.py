"""Two things about a dataset to say before training starts: it is absent, or some values are not finite."""

import functools
from collections.abc import Callable, Iterable
from pathlib import Path

import httpx
import numpy as np
from huggingface_hub.errors import LocalEntryNotFoundError, OfflineModeIsEnabled
from jaxtyping import Bool
from lerobot.configs.train import TrainPipelineConfig
from lerobot.utils.constants import HF_LEROBOT_HOME
from lerobot.utils.feature_utils import dataset_to_policy_features

from lerobot_act_chunking.compat import check_one_average
from lerobot_act_chunking.data.fast_chunks.columns import Column
from lerobot_act_chunking.data.fast_chunks.dataset import FastChunkDataset
from lerobot_act_chunking.data.missing_files import what_is_missing
from lerobot_act_chunking.errors import DatasetError

HUB_ERRORS = (httpx.HTTPError, OfflineModeIsEnabled, LocalEntryNotFoundError)
"""What LeRobot raises if a dataset is neither on this machine nor on a hub that it can reach."""


def with_checks[Dataset](
    make_dataset: Callable[[TrainPipelineConfig], Dataset],
) -> Callable[[TrainPipelineConfig], Dataset]:
    """LeRobot's ``make_dataset``, with errors that name the cause.

    Only training comes through it. Datasets that are merely opened, to be looked at or mended, are not
    checked.

    Returns:
        The same function, except that it raises a ``DatasetError`` if there is no dataset, or if an
        observation, an action or another chunked column holds NaN or infinity, which would spoil the training
        unnoticed.
    """

    @functools.wraps(make_dataset)
    def make_checked_dataset(cfg: TrainPipelineConfig) -> Dataset:
        check_one_average(cfg)
        try:
            dataset = make_dataset(cfg)
        except HUB_ERRORS as error:
            # "from None": the hub client's chain of tracebacks would bury the message, which quotes it.
            raise _absent(cfg.dataset.repo_id, cfg.dataset.root, error) from None
        if isinstance(dataset, FastChunkDataset) and dataset.chunks is not None:
            learned = {*dataset_to_policy_features(dataset.features), *(dataset.delta_timestamps or {})}
            require_finite(dataset.chunks.columns, learned, dataset.repo_id)
        return dataset

    return make_checked_dataset


def require_finite(columns: dict[str, Column], keys: Iterable[str], dataset: str) -> None:
    """Refuses NaN and infinity in the columns among ``keys``.

    Raises:
        DatasetError: naming every such column, in how many frames, and the first of them.
    """
    faults = [fault for key in sorted(keys) if key in columns and (fault := _fault(key, columns))]
    if faults:
        raise DatasetError(
            f"dataset {dataset!r} holds values that are not finite: {'; '.join(faults)}. "
            "Leave those episodes out (--dataset.episodes) or record them again"
        )


def _fault(key: str, columns: dict[str, Column]) -> str | None:
    rows = np.flatnonzero(np.concatenate([_bad_rows(piece) for piece in columns[key].pieces]))
    if not rows.size:
        return None
    episode, frame = (int(columns[name].gather(rows[:1])) for name in ("episode_index", "frame_index"))
    return f"{key} in {rows.size} frames, first in episode {episode}, frame {frame}"


def _bad_rows(piece: np.ndarray) -> Bool[np.ndarray, " rows"]:
    if piece.dtype.kind != "f":
        return np.zeros(len(piece), bool)
    return np.logical_not(np.isfinite(piece).reshape(len(piece), -1).all(axis=1))


def _absent(repo_id: str, root: str | None, error: Exception) -> DatasetError:
    folder = Path(root) if root else HF_LEROBOT_HOME / repo_id
    reason = str(error).strip().splitlines()[0]
    way_out = (  # nothing is recorded into a folder that may be somebody's
        "Name a LeRobotDataset's folder with --dataset.root, or copy what is missing into this one"
        if folder.exists()
        else f"Record one: act-chunking record --task transfer_cube --repo-id {repo_id} --root {folder}"
    )
    return DatasetError(
        f"{folder} {what_is_missing(folder)}, and {repo_id!r} could not be fetched from the Hugging Face hub "
        f"({reason}). {way_out}"
    )
