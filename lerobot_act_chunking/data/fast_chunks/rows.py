"""Rows that a policy cannot learn from, refused before training: no numbers, or out of place."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Bool, Int64
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from lerobot_act_chunking.data.fast_chunks.columns import Column, numeric_columns
from lerobot_act_chunking.data.fast_chunks.reading import Reading
from lerobot_act_chunking.errors import DatasetError

PLACES = ("index", "episode_index", "frame_index")


def check_rows(dataset: LeRobotDataset, reading: Reading) -> None:
    """Refuse a dataset of which what is read would spoil a training unnoticed.

    Raises:
        DatasetError: naming the columns that hold NaN, infinity or gaps, in how many frames, and the first of
            them; or the first row that is not where the episodes' table says.
    """
    columns = numeric_columns(dataset.hf_dataset)
    if missing := [key for key in PLACES if key not in columns]:
        raise DatasetError(f"dataset {dataset.repo_id!r} lacks the numbers of {', '.join(missing)}")
    _check_places(dataset, columns)
    cameras = dataset.meta.camera_keys
    read = sorted(key for key in reading.columns if key in dataset.features and key not in cameras)
    bad = {key: rows for key in read if (rows := _bad_rows(columns.get(key), len(dataset.hf_dataset))).size}
    if bad:
        raise DatasetError(_not_finite(dataset, reading, bad, columns))


def _check_places(dataset: LeRobotDataset, columns: Mapping[str, Column]) -> None:
    """Refuse rows in whose place LeRobot would take others: it finds a chunk's steps by their ``index``."""
    rows = np.arange(len(dataset.hf_dataset))
    index, episode = (columns[key].take(rows) for key in ("index", "episode_index"))
    episodes: Any = dataset.meta.episodes
    first, end = (np.asarray(episodes[f"dataset_{name}_index"][:]) for name in ("from", "to"))
    starts = np.flatnonzero(np.diff(episode, prepend=episode[:1] - 1))
    for start, stop in pairwise([*starts, len(rows)]):
        number = int(episode[start])
        expected = np.arange(first[number], end[number]) if 0 <= number < len(first) else rows[:0]
        misplaced = dataset.episodes is None and start not in expected[:1]  # an index is then taken for a row
        if misplaced or not np.array_equal(index[start:stop], expected):
            raise DatasetError(
                f"dataset {dataset.repo_id!r} is damaged: rows {start} to {stop - 1}, of episode {number}, "
                f"have index {_span(index[start:stop])}, but by meta/episodes they have {_span(expected)}. "
                "Chunks would be made of other frames than theirs. Fetch or record it again"
            )


def _span(index: Int64[np.ndarray, " rows"]) -> str:
    if not index.size:
        return "none"
    broken = "" if (np.diff(index) == 1).all() else ", not one after the other"
    return f"{index[0]} to {index[-1]}{broken}"


def _bad_rows(column: Column | None, count: int) -> Int64[np.ndarray, " bad"]:
    if column is None:  # gaps, or rows of different shapes
        return np.arange(count)
    return np.flatnonzero(np.concatenate([_not_finite_rows(piece) for piece in column.pieces]))


def _not_finite_rows(piece: np.ndarray) -> Bool[np.ndarray, " rows"]:
    if piece.dtype.kind != "f":
        return np.zeros(len(piece), bool)
    return np.logical_not(np.isfinite(piece).reshape(len(piece), -1).all(axis=1))


def _not_finite(
    dataset: LeRobotDataset,
    reading: Reading,
    bad: Mapping[str, Int64[np.ndarray, " bad"]],
    columns: Mapping[str, Column],
) -> str:
    faults = []
    for key, rows in bad.items():
        episode, frame = (int(columns[name].take(rows[:1])[0]) for name in ("episode_index", "frame_index"))
        faults.append(f"{key} in {rows.size} frames, first in episode {episode}, frame {frame}")
    episodes = sorted({int(each) for rows in bad.values() for each in columns["episode_index"].take(rows)})
    setting = reading.leave_out(list(bad))
    ways = [] if setting is None else [f"leave the columns out with {setting}"]
    if len(episodes) < dataset.meta.total_episodes:
        ways.append(
            f"make a copy without those episodes: lerobot-edit-dataset --repo_id={dataset.repo_id} "
            f"--root={dataset.root} --new_repo_id={dataset.repo_id}_finite --operation.type=delete_episodes "
            f"--operation.episode_indices='{episodes}', and train on that: "
            f"--dataset.repo_id={dataset.repo_id}_finite, without --dataset.root"
        )
    return f"dataset {dataset.repo_id!r} holds values that are not finite: {'; '.join(faults)}. " + (
        " Or ".join(way[0].upper() + way[1:] for way in ways) or "Record it again"
    )
