"""At which frequencies demonstrations move."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes

STRAIGHT = 1e-12
"""Energy, as a share of the squared range, that straight lines leave behind by rounding."""
SHORTEST = 8
"""Control steps below which an episode has no spectrum worth the name."""


@dataclass(frozen=True)
class Spectrum:
    """Power of each action dimension by frequency, mean over episodes.

    Attributes:
        frequencies: (F,) [Hz], from 0 to half the control rate.
        power: (F, A), in squared raw units.
        moves: (A,) whether the dimension moves, by its noise floor.
    """

    frequencies: np.ndarray
    power: np.ndarray
    moves: np.ndarray

    def above(self, frequency: float) -> np.ndarray:
        """Share (A,) of each dimension's energy above ``frequency`` [Hz]; NaN where nothing moves."""
        total = np.where(self.moves, self.power.sum(0), np.nan)
        return self.power[self.frequencies > frequency].sum(0) / total

    def all_above(self, frequency: float) -> float:
        """The same of all dimensions together, each scaled to the same energy; NaN if nothing moves."""
        shares = self.above(frequency)[self.moves]
        return float(shares.mean()) if len(shares) else float("nan")


def measure_spectrum(demonstrations: ActionEpisodes, moving: Sequence[int] | None = None) -> Spectrum:
    """Periodograms of whole episodes: straight line removed, Hann window, interpolated to common frequencies.

    Without either, the step from an episode's end back to its start would spread over all frequencies.

    Args:
        demonstrations: the actions.
        moving: dimensions that count, if they change at all; by default all.
    """
    from scipy.signal import periodogram

    everything = np.concatenate(list(demonstrations.episodes.values()))
    spans = np.ptp(everything, axis=0)
    lengths = [n for rows in demonstrations.episodes.values() if (n := len(rows)) >= SHORTEST]
    grid = np.fft.rfftfreq(max(lengths, default=SHORTEST), 1 / demonstrations.fps)
    power = np.zeros((len(grid), everything.shape[1]))
    for rows in demonstrations.episodes.values():
        if len(rows) < SHORTEST:
            continue
        frequencies, density = periodogram(
            rows.astype(np.float64), demonstrations.fps, window="hann", detrend="linear", axis=0
        )
        for dim in range(power.shape[1]):
            power[:, dim] += np.interp(grid, frequencies, density[:, dim]) * len(rows)
    counts = np.isin(np.arange(len(spans)), range(len(spans)) if moving is None else moving)
    moves = counts & (spans > 0) & (power.sum(0) > STRAIGHT * spans**2)
    return Spectrum(grid, power / len(everything), moves)
