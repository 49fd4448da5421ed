"""What the actions of a dataset ask for: where to be, or how to change."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from jaxtyping import Float

from lerobot_act_chunking.data.batch import ACTION

MOST_FRAMES = 20_000  # enough to tell, and read in a tenth of a second
FEWEST_FRAMES = 50
MOST_DIMENSIONS = 512  # of the states together; a least-squares fit of more takes seconds
_LATER = (1, 2, 3, 5)  # control steps until the state shows what was asked for
_LEAST_SHARE = 0.5  # of an action's variance that changes must explain


def asks_for_changes(
    states: Float[np.ndarray, "F S"], actions: Float[np.ndarray, "F A"], episode: np.ndarray
) -> bool:
    """Whether actions are changes of the state, as end-effector displacements and velocities are.

    Fits every action by a linear function of the state a little later, and of how the state has changed until
    then. Positions are explained by the one, changes by the other, whatever the unit and the order of both;
    the median action dimension decides, because grippers are often positions on any robot.

    Args:
        states: observed, at least `FEWEST_FRAMES` rows.
        actions: commanded in the same frames.
        episode: index (F,) of each frame's episode.

    Returns:
        False also where neither explains the actions.
    """
    moving = actions.std(0) > 1e-6 * np.maximum(np.abs(actions).max(0), 1e-12)
    if not moving.any():
        return False
    as_position, as_change = np.zeros(moving.sum()), np.zeros(moving.sum())
    for later in _LATER:
        same = episode[later:] == episode[:-later]
        asked = actions[:-later][same][:, moving]
        if len(asked) < FEWEST_FRAMES:
            break
        reached, began = states[later:][same], states[:-later][same]
        as_position = np.maximum(as_position, _explained(reached, asked))
        as_change = np.maximum(as_change, _explained(reached - began, asked))
    return bool(np.median(as_change) > max(_LEAST_SHARE, float(np.median(as_position))))


def _explained(inputs: Float[np.ndarray, "F S"], outputs: Float[np.ndarray, "F A"]) -> np.ndarray:
    """Share (A,) of the outputs' variance that a linear function of the inputs explains."""
    inputs, outputs = inputs - inputs.mean(0), outputs - outputs.mean(0)
    weights, *_ = np.linalg.lstsq(inputs, outputs, rcond=None)
    variance = (outputs**2).sum(0)
    return 1 - ((outputs - inputs @ weights) ** 2).sum(0) / np.where(variance > 0, variance, 1.0)


def dataset_asks_for_changes(folder: Path, features: dict[str, Any], state_keys: Sequence[str]) -> bool:
    """`asks_for_changes` of a LeRobotDataset's first frames; False where that cannot be told.

    Args:
        folder: of the dataset; its files need not be there (streaming).
        features: of the dataset.
        state_keys: state vectors among them.
    """
    states = [key for key in state_keys if features[key]["dtype"].startswith("float")]
    width = sum(int(np.prod(features[key]["shape"])) for key in states)
    if not 0 < width <= MOST_DIMENSIONS:
        return False
    rows = _first_rows(folder, (*states, ACTION, "episode_index"))
    if rows is None:
        return False
    observed = np.concatenate([rows[key] for key in states], axis=1)
    actions, episode = rows[ACTION], rows["episode_index"][:, 0]
    finite = np.isfinite(observed).all(1) & np.isfinite(actions).all(1)
    if finite.sum() < FEWEST_FRAMES:
        return False
    return asks_for_changes(observed[finite], actions[finite], episode[finite])


def _first_rows(folder: Path, columns: Sequence[str]) -> dict[str, Float[np.ndarray, "F _"]] | None:
    """The first `MOST_FRAMES` rows of these columns, or a few more; None without any."""
    parts: dict[str, list[np.ndarray]] = {key: [] for key in columns}
    n_frames = 0
    for batch in _batches(folder, columns):
        for key, values in parts.items():
            values.append(np.array(batch[key].to_pylist(), dtype=float).reshape(len(batch), -1))
        n_frames += len(batch)
        if n_frames >= MOST_FRAMES:
            break
    return {key: np.concatenate(values) for key, values in parts.items()} if n_frames else None


def _batches(folder: Path, columns: Sequence[str]) -> Iterator[Any]:
    for file in sorted((folder / "data").rglob("*.parquet")):
        yield from pq.ParquetFile(file).iter_batches(4096, columns=list(columns))
