"""How far predicted chunks are from what was demonstrated, and whether they follow it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

SOON_S = 0.5
"""First part of a chunk [s], in which the policy is held against its last action and the current state."""
DRAWS = 1000  # of episodes, behind the interval
OUTSIDE = 0.5  # of a dimension's range, beyond which nobody ever was


@dataclass(frozen=True)
class Chunks:
    """What is predicted and what was done at M frames, over T steps, in raw units; NaN after the end.

    Attributes:
        episode: (M,) of each frame.
        predicted: (M, T, A).
        demonstrated: (M, T, A).
        still: (M, T, A): the current state where it has the action's name, else the last action, kept.
        last: (M, A): the last action.
        nearest: (M, T, A): what was done at the nearest observation of another episode; None of one episode.
    """

    episode: np.ndarray
    predicted: np.ndarray
    demonstrated: np.ndarray
    still: np.ndarray
    last: np.ndarray
    nearest: np.ndarray | None

    def errors(self, chunks: np.ndarray) -> np.ndarray:
        """Distance (M, T, A) of chunks from what was done."""
        return np.abs(chunks - self.demonstrated)


@dataclass(frozen=True)
class Horizon:
    """Errors by step of the horizon (T, A), in raw units; NaN after the end of all episodes.

    Attributes:
        median: of the frames, by ``policy``, ``hold_still`` and ``nearest`` (as far as there is one).
        p90: what 90 % of the frames stay below, by the same.
    """

    median: dict[str, np.ndarray]
    p90: dict[str, np.ndarray]


@dataclass(frozen=True)
class Following:
    """Whether chunks follow the demonstrator; over dimensions that move, in standard deviations.

    Attributes:
        errors: mean error over all chunks, by who makes it: as in `Horizon`, and ``mean_action``.
        against_nearest: the policy's error by that of the nearest demonstration, with the ends of its 95 %
            interval over episodes; None without another episode.
        reduction: share of the error of holding still that the policy avoids in the first half second.
        correlation: of predicted and demonstrated change from the last action there.
        departure: mean distance from the last action there, by the demonstrator's; 0 repeats it.
        departure_state: the same from what holds still (the current state, where names match).
        variation: spread of the first predicted action over all frames, by the demonstrated one's; 0 does
            the same everywhere.
        outside: (A,) share of the predictions that are far from where anybody ever was.
    """

    errors: dict[str, float]
    against_nearest: tuple[float, float, float] | None
    reduction: float
    correlation: float
    departure: float
    departure_state: float
    variation: float
    outside: np.ndarray


def measure_horizon(chunks: Chunks) -> Horizon:
    """Errors of each dimension at each step."""
    found = {name: chunks.errors(each) for name, each in _who(chunks).items()}
    return Horizon(
        median={name: _quantile(each, 0.5) for name, each in found.items()},
        p90={name: _quantile(each, 0.9) for name, each in found.items()},
    )


def measure_following(
    chunks: Chunks, actions: np.ndarray, moving: Sequence[int], fps: float, rng: np.random.Generator
) -> Following:
    """Whether chunks follow the demonstrator.

    Args:
        chunks: at some frames.
        actions: (F, A) of the whole dataset.
        moving: dimensions that count; at least one.
        fps: control steps per second.
        rng: draws episodes for the interval.
    """
    spread, mean = actions.std(0)[moving], np.broadcast_to(actions.mean(0), chunks.predicted.shape)
    per_frame = {
        name: np.nanmean(chunks.errors(each)[..., moving] / spread, axis=(1, 2))
        for name, each in {**_who(chunks), "mean_action": mean}.items()
    }
    soon = slice(0, max(1, round(SOON_S * fps)))
    predicted, done, still = (
        each[:, soon][..., moving] / spread for each in (chunks.predicted, chunks.demonstrated, chunks.still)
    )
    last = chunks.last[:, None, moving] / spread
    return Following(
        errors={name: float(each.mean()) for name, each in per_frame.items()},
        against_nearest=_ratio(per_frame["policy"], per_frame["nearest"], chunks.episode, rng)
        if "nearest" in per_frame
        else None,
        reduction=1 - _quotient(_mean_distance(predicted, done), _mean_distance(still, done)),
        correlation=_correlation(predicted - last, done - last),
        departure=_quotient(_mean_distance(predicted, last), _mean_distance(done, last)),
        departure_state=_quotient(_mean_distance(predicted, still), _mean_distance(done, still)),
        variation=float(np.median(predicted[:, 0].std(0) / np.maximum(done[:, 0].std(0), 1e-9))),
        outside=_outside(chunks.predicted, actions),
    )


def by_person(
    chunks: Chunks, operators: dict[int, str], spread: np.ndarray, moving: Sequence[int]
) -> dict[str, dict[str, Any]]:
    """Mean errors at each person's frames, as in `Following`; none where nobody is named."""
    people = np.array([operators.get(int(each), "") for each in chunks.episode])
    found = {}
    for person in sorted({*people.tolist()} - {""}):
        errors = {
            name: float(np.nanmean((chunks.errors(each)[people == person][..., moving]) / spread[moving]))
            for name, each in _who(chunks).items()
        }
        found[person] = {"episodes": len({*chunks.episode[people == person].tolist()}), **errors}
    return found


def _who(chunks: Chunks) -> dict[str, np.ndarray]:
    found = {"policy": chunks.predicted, "hold_still": chunks.still}
    return found if chunks.nearest is None else {**found, "nearest": chunks.nearest}


def _quantile(errors: np.ndarray, share: float) -> np.ndarray:
    """Over the frames (M, T, A); NaN at steps after the end of all episodes."""
    found = np.full(errors.shape[1:], np.nan)
    known = ~np.isnan(errors).all((0, 2))
    found[known] = np.nanquantile(errors[:, known], share, axis=0)
    return found


def _mean_distance(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.nanmean(np.abs(one - other)))


def _quotient(one: float, other: float) -> float:
    return one / max(other, 1e-9)


def _correlation(predicted: np.ndarray, done: np.ndarray) -> float:
    known = ~np.isnan(done)
    if not known.any() or predicted[known].std() < 1e-9 or done[known].std() < 1e-9:
        return 0.0
    return float(np.corrcoef(predicted[known], done[known])[0, 1])


def _ratio(
    policy: np.ndarray, nearest: np.ndarray, episode: np.ndarray, rng: np.random.Generator
) -> tuple[float, float, float]:
    """Of two errors, with its percentile interval over episodes that are drawn anew."""
    sums = np.array([(policy[episode == e].sum(), nearest[episode == e].sum()) for e in np.unique(episode)])
    drawn = sums[rng.integers(len(sums), size=(DRAWS, len(sums)))].sum(1)
    low, high = np.quantile(drawn[:, 0] / np.maximum(drawn[:, 1], 1e-9), (0.025, 0.975))
    return _quotient(policy.sum(), nearest.sum()), float(low), float(high)


def _outside(predicted: np.ndarray, actions: np.ndarray) -> np.ndarray:
    low, high = actions.min(0), actions.max(0)
    beyond = np.maximum(OUTSIDE * (high - low), 1e-6 * np.maximum(np.abs(low), np.abs(high)) + 1e-9)
    return ((predicted < low - beyond) | (predicted > high + beyond)).mean((0, 1))
