"""Which of several equally valid ways each demonstration goes: as recorded, or by clusters of its motion."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int64

from lerobot_act_chunking.errors import DatasetError
from lerobot_act_chunking.json_files import read_json

RECORDING = "meta/recording.json"
"""What ``act-chunking record`` writes; ``details.mode`` of an episode is its way."""
PLACES = 16  # of a motion, evenly spaced in time, that clusters are found by
MOST_MODES = 8
MOST_EPISODES = 2000
CLEAR = 0.5
"""Mean silhouette from which clusters count as modes: "reasonable structure" (Kaufman and Rousseeuw 1990)."""
_FEWEST = 2  # episodes of a mode; a single one is an outlier


def recorded_modes(folder: Path) -> dict[int, int]:
    """The mode of each episode by its index, as recorded; empty where nothing is said of modes.

    Raises:
        DatasetError: the recording's summary is damaged.
    """
    path = folder / RECORDING
    if not path.is_file():
        return {}
    try:
        found = {
            int(each["episode_index"]): int(each["details"]["mode"])
            for each in read_json(path)["episodes"]
            if "mode" in each["details"]
        }
    except (ValueError, KeyError, TypeError) as error:
        raise DatasetError(f"{path} cannot be read ({error!r}): restore it, or remove it") from error
    if min(found.values(), default=0) < 0:
        raise DatasetError(f"{path} has a negative mode: modes are counted from 0 on")
    return found


def require_recorded_modes(folder: Path) -> dict[int, int]:
    """As `recorded_modes`, where a policy is to learn by them.

    Raises:
        DatasetError: the recording says nothing of modes, or is damaged.
    """
    found = recorded_modes(folder)
    if not found:
        raise DatasetError(
            f"balance_modes=labels needs the mode of each episode, and {folder / RECORDING} has none: set "
            "--policy.balance_modes=clusters, or none"
        )
    return found


def clustered_modes(motions: Sequence[Float[np.ndarray, "_ A"]]) -> Int64[np.ndarray, " N"]:
    """Modes of whole motions, the most frequent one 0: k-means, as many clusters as are told apart best.

    Motions are compared at evenly spaced times, in units of each dimension's `spread`. The number of clusters
    has the best mean silhouette (Rousseeuw 1987); it is one, unless that is `CLEAR`. The same motions always
    give the same modes.

    Args:
        motions: actions of each episode, of any length; of more than `MOST_EPISODES`, the others join the
            nearest cluster.
    """
    from sklearn.cluster import KMeans
    from sklearn.metrics import silhouette_score

    points = _points(motions)
    fitted = points[np.linspace(0, len(points) - 1, min(len(points), MOST_EPISODES)).round().astype(int)]
    best, clearest = np.zeros(len(points), np.int64), CLEAR
    for count in range(2, min(MOST_MODES, len(fitted) // _FEWEST) + 1):
        if len(np.unique(fitted, axis=0)) < count:
            break
        means = KMeans(count, n_init=10, random_state=0).fit(fitted)  # pyright: ignore[reportArgumentType]
        labels = np.asarray(means.predict(fitted))
        if np.bincount(labels).min() < _FEWEST:
            continue
        clarity = float(silhouette_score(fitted, labels))
        if clarity > clearest:
            best, clearest = _by_size(np.asarray(means.predict(points))), clarity
    return best


def mode_weights(modes: Mapping[int, int], lengths: Mapping[int, int], power: float) -> dict[int, float]:
    """Weight of each episode's samples: (1 / its mode's share of the samples) ** power, with mean 1.

    Args:
        modes: of each episode.
        lengths: samples of each episode.
        power: 0 weighs all alike; with 1 all modes have the same part in a loss.
    """
    samples: dict[int, int] = {}
    for episode, mode in modes.items():
        samples[mode] = samples.get(mode, 0) + lengths[episode]
    total = sum(samples.values())
    raw = {mode: (total / count) ** power for mode, count in samples.items()}
    mean = sum(raw[mode] * count for mode, count in samples.items()) / total
    return {episode: raw[mode] / mean for episode, mode in modes.items()}


def _points(motions: Sequence[Float[np.ndarray, "_ A"]]) -> Float[np.ndarray, "N D"]:
    """Motions as points: their actions at `PLACES` times, in units of each dimension's `spread`."""
    rows = [np.linspace(0, len(each) - 1, PLACES).round().astype(int) for each in motions]
    points = np.stack([each[row] for each, row in zip(motions, rows, strict=True)]).astype(np.float64)
    return (points / spread(points)).reshape(len(points), -1)


def spread(actions: Float[np.ndarray, "*N A"]) -> Float[np.ndarray, " A"]:
    """The unit of each dimension: its standard deviation, or a tenth of the largest where it hardly moves."""
    deviations = actions.reshape(-1, actions.shape[-1]).std(0)
    return np.maximum(deviations, max(0.1 * deviations.max(), 1e-9))


def _by_size(labels: np.ndarray) -> Int64[np.ndarray, " N"]:
    """Clusters renumbered from 0, the largest first."""
    _, index, sizes = np.unique(labels, return_inverse=True, return_counts=True)
    return np.argsort(np.argsort(-sizes, kind="stable"), kind="stable")[index]
