"""Which dimensions of demonstrations move, and which only tremble, stand still or are parked."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

WINDOW_S = 0.3
"""Time within which what stands out of its surroundings counts as noise [s]."""
MOST_NOISE = 1 / 30
"""Noise, as a share of what a dimension varies in an episode, from which it does not move, but tremble."""
ROUNDING = 1e-6
"""Range, as a share of the largest value, that 32-bit numbers leave behind by rounding."""
SWITCH = 0.2
"""Change within a control step, as a share of the range, that nobody moves through: a switch."""
FEWEST_STEPS = 5
"""Control steps that an episode needs to show noise."""
LEFT_OF_WHITE_NOISE = (18 / 35) ** 0.5
"""What a parabola over five steps leaves of white noise (rms)."""


@dataclass(frozen=True)
class Dimension:
    """How one number of an action or a state behaves.

    Everything relative is relative to the dimension itself: other units change nothing.

    Attributes:
        name: of the dimension.
        kind: ``moves``; ``noise`` if it does not stand out of its own noise in half of the episodes or more
            (a parked arm); or ``constant``.
        switches: whether most of its change happens in leaps of a fifth of its range or more.
        noise: of the median episode, as a share of what the dimension varies in it (rms over standard
            deviation).
        step: smallest difference between its values [raw units]; 0 where it is constant.
        episodes: share of the episodes in which it moves.
    """

    name: str
    kind: str
    switches: bool
    noise: float
    step: float
    episodes: float


@dataclass(frozen=True)
class NoiseFloor:
    """All dimensions of some episodes."""

    dimensions: tuple[Dimension, ...]

    @property
    def moving(self) -> list[int]:
        """Dimensions that move: the ones that verdicts rest on."""
        return [dim for dim, found in enumerate(self.dimensions) if found.kind == "moves"]

    @property
    def switching(self) -> list[int]:
        """Moving dimensions that leap: no interpolation follows them."""
        return [dim for dim in self.moving if self.dimensions[dim].switches]

    @property
    def notes(self) -> list[str]:
        """What is left out of verdicts, in sentences."""
        notes = []
        for kind, text in (
            ("constant", "never change"),
            ("noise", "hardly move: parked, or trembling, in half of the episodes or more"),
        ):
            names = [found.name for found in self.dimensions if found.kind == kind]
            if names:
                share = f"{len(names)} of {len(self.dimensions)} dimensions"
                notes.append(f"{share} {text}, and do not count: {listed(names)}.")
        return notes

    def to_json(self) -> list[dict[str, Any]]:
        """Plain numbers and strings."""
        return [asdict(found) for found in self.dimensions]


def listed(names: Sequence[str], most: int = 8) -> str:
    """Names in one line."""
    shown = ", ".join(names[:most])
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"


def measure_noise(episodes: Sequence[np.ndarray], fps: float, names: Sequence[str]) -> NoiseFloor:
    """Find out which dimensions move.

    Noise is what neither the running median of ``WINDOW_S`` explains, which follows a leap, nor a parabola
    over as long, which follows a bend, nor one over `FEWEST_STEPS` steps, which follows fast motion.

    Args:
        episodes: (L, A) each, in any units.
        fps: control steps per second.
        names: of the A dimensions.
    """
    whole = np.concatenate(episodes).astype(np.float64)
    window = max(FEWEST_STEPS, 2 * round(WINDOW_S * fps / 2) + 1)
    still = np.ptp(whole, axis=0) <= ROUNDING * np.abs(whole).max(0)
    shares = np.stack([_noise_shares(np.asarray(rows, np.float64), window) for rows in episodes])  # (E, A)
    shares[:, still] = 1.0
    noise = np.median(shares, axis=0)
    leaps = _leap_shares(episodes, np.ptp(whole, axis=0))
    return NoiseFloor(
        tuple(
            Dimension(
                name=name,
                kind="constant" if still[dim] else "noise" if noise[dim] > MOST_NOISE else "moves",
                switches=bool(leaps[dim] > 0.5 and not still[dim]),
                noise=float(noise[dim]),
                step=0.0 if still[dim] else _step(whole[:, dim]),
                episodes=float((shares[:, dim] <= MOST_NOISE).mean()),
            )
            for dim, name in enumerate(names)
        )
    )


def _noise_shares(rows: np.ndarray, window: int) -> np.ndarray:
    """Noise of an episode (L, A) by what varies in it (A,); 1 where nothing does."""
    from scipy.ndimage import median_filter
    from scipy.signal import savgol_filter

    window = min(window, len(rows) - 1 + len(rows) % 2)
    if window < FEWEST_STEPS:
        return np.ones(rows.shape[1])
    off_median = np.abs(rows - median_filter(rows, (window, 1), mode="nearest"))
    off_parabola = np.abs(rows - savgol_filter(rows, window, 2, axis=0))
    off_near = np.abs(rows - savgol_filter(rows, FEWEST_STEPS, 2, axis=0)) / LEFT_OF_WHITE_NOISE
    noise = np.sqrt(np.square(np.minimum.reduce([off_median, off_parabola, off_near])).mean(0))
    spread = rows.std(0)
    varies = spread > ROUNDING * np.abs(rows).max(0)
    return np.where(varies, noise / np.where(varies, spread, 1.0), 1.0)


def _leap_shares(episodes: Sequence[np.ndarray], spans: np.ndarray) -> np.ndarray:
    """Share (A,) of the path of each dimension that it goes in leaps."""
    changes = np.concatenate([np.abs(np.diff(rows.astype(np.float64), axis=0)) for rows in episodes])
    total = changes.sum(0)
    leaps = np.where(changes > SWITCH * spans, changes, 0.0).sum(0)
    return leaps / np.where(total > 0, total, 1.0)


def _step(values: np.ndarray) -> float:
    return float(np.diff(np.unique(values)).min())
