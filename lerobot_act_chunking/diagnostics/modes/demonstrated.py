"""The ways that were demonstrated, and which of them a chunk goes."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, Int64

from lerobot_act_chunking.data.episode_modes import clustered_modes, recorded_modes, spread
from lerobot_act_chunking.diagnostics.core.episodes import read_episodes
from lerobot_act_chunking.errors import DatasetError

WITHIN, BETWEEN = 99.0, 1.0  # percentiles of the demonstrations' distances inside of a way, and to others
VALID = 0.25  # of the distance to another way, up to which a chunk goes a way
LEAST = 0.01  # distance inside of a way where demonstrations are (nearly) the same
Source = Literal["recording", "clusters"]


@dataclass(frozen=True)
class Reference:
    """Demonstrated chunks that begin at one step of their episodes.

    Attributes:
        chunks: (N, T, A) in units of each dimension's spread.
        modes: (N,) the way of each.
        within: distance to the nearest other chunk of the same way, that 99 % of the chunks stay below; the
            distance of two chunks is the root of their mean squared difference.
        between: distance to the nearest chunk of another way, that 99 % stay above; infinite for one way.
    """

    chunks: Float[np.ndarray, "N T A"]
    modes: Int64[np.ndarray, " N"]
    within: float = field(init=False)
    between: float = field(init=False)

    def __post_init__(self) -> None:
        apart = _distances(self.chunks, self.chunks)
        np.fill_diagonal(apart, np.inf)
        same = self.modes[:, None] == self.modes
        own, other = (np.where(mask, apart, np.inf).min(1) for mask in (same, ~same))
        own, other = own[np.isfinite(own)], other[np.isfinite(other)]
        within = max(LEAST, float(np.percentile(own, WITHIN))) if own.size else LEAST
        object.__setattr__(self, "within", within)
        object.__setattr__(self, "between", float(np.percentile(other, BETWEEN)) if other.size else np.inf)

    @property
    def tells_apart(self) -> bool:
        """Whether chunks of one way are much nearer to each other than to those of others."""
        return self.within < self.between / 2

    @property
    def limit(self) -> float:
        """Distance from every demonstrated chunk beyond which a chunk goes no demonstrated way.

        A quarter of ``between``: half of it is the middle between two ways, and policies are less precise
        than demonstrations are. At least ``within``; of a single way, twice that.
        """
        if not np.isfinite(self.between):
            return 2 * self.within
        return max(self.within, VALID * self.between)

    def classify(self, chunks: Float[np.ndarray, "n T A"]) -> Int64[np.ndarray, " n"]:
        """The way of the nearest demonstrated chunk; -1 beyond the limit. In the same units."""
        apart = _distances(chunks, self.chunks)
        return np.where(apart.min(1) <= self.limit, self.modes[apart.argmin(1)], -1)


@dataclass(frozen=True)
class Demonstrated:
    """Demonstrations and their ways.

    Attributes:
        folder: of the dataset.
        source: what says which way each goes.
        episodes: (N,) their indices.
        motions: actions (L, A) of each, in units of each dimension's spread.
        modes: (N,) the way of each, from 0 on.
        unit: (A,) the spread, in raw units.
    """

    folder: str
    source: Source
    episodes: Int64[np.ndarray, " N"]
    motions: Sequence[Float[np.ndarray, "_ A"]]
    modes: Int64[np.ndarray, " N"]
    unit: Float[np.ndarray, " A"]

    @property
    def proportions(self) -> tuple[float, ...]:
        """Share of the demonstrations that go each way."""
        return tuple((np.bincount(self.modes) / len(self.modes)).tolist())

    @property
    def length(self) -> int:
        """Median length of an episode [control steps]."""
        return int(np.median([len(each) for each in self.motions]))

    def reference(self, step: int, length: int) -> Reference:
        """Demonstrated chunks of ``length`` actions that begin at ``step``; last actions are held."""
        return Reference(np.stack([_held(each, step, length) for each in self.motions]), self.modes)

    def scaled(self, actions: Float[np.ndarray, "*n A"]) -> Float[np.ndarray, "*n A"]:
        """Actions of the environment in units of each dimension's spread."""
        return actions / self.unit

    def whole(self, commands: Sequence[Float[np.ndarray, "_ A"]]) -> Int64[np.ndarray, " n"]:
        """The way that each commanded motion goes, over as long as a demonstration takes."""
        motions = np.stack([_held(self.scaled(each), 0, self.length) for each in commands])
        return self.reference(0, self.length).classify(motions)


def read_demonstrated(folder: str, only: Sequence[int] | None = None) -> Demonstrated:
    """The demonstrations of a LeRobotDataset with their ways: as recorded, else by clusters of their motions.

    Args:
        folder: of the dataset.
        only: episodes that were used; None for all.

    Raises:
        DatasetError: there is none, it is damaged, or has none of these episodes.
    """
    found = read_episodes(folder)
    actions = (found if only is None else found.only(only)).episodes
    if not actions:
        raise DatasetError(f"the dataset at {folder} has none of the training's episodes: give --dataset")
    motions, episodes = list(actions.values()), np.array(list(actions))
    unit = spread(np.concatenate(motions))
    recorded = recorded_modes(Path(folder))
    source: Source = "recording" if recorded.keys() >= set(actions) else "clusters"
    modes = (
        np.array([recorded[each] for each in actions]) if source == "recording" else clustered_modes(motions)
    )
    return Demonstrated(folder, source, episodes, [each / unit for each in motions], modes, unit)


def _held(motion: Float[np.ndarray, "L A"], step: int, length: int) -> Float[np.ndarray, "T A"]:
    return motion[np.minimum(np.arange(step, step + length), len(motion) - 1)]


def _distances(
    chunks: Float[np.ndarray, "n T A"], others: Float[np.ndarray, "N T A"]
) -> Float[np.ndarray, "n N"]:
    """Root of the mean squared difference of each two."""
    from scipy.spatial.distance import cdist

    flat, other = (each.reshape(len(each), -1) for each in (chunks, others))
    return cdist(flat, other) / np.sqrt(flat.shape[1])
