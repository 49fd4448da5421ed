"""What executing overlapping chunks does to innovations, in closed form.

Notation: the chunk computed at control step s predicts ``p_s(t) = r(t) + e(s)`` for step t, where r is what
every chunk agrees on (the plan) and e(s) is what the observation at s changed (the innovation). Chunks are
computed every R steps and used at the ages d .. K-1 (age: t - s). The executed command is then
``r(t) + sum_j h_j e(t - j)``: the plan passes untouched and only innovations are filtered.

With R > 1 the weights depend on the replan phase ``t mod R``, but a chunk of age j is only ever used in the
phase ``j mod R``. One vector therefore holds every phase: its entry j is the weight in that phase, divided by
R, which is also the mean over all phases. Because consecutive chunks keep their relative weights as they age,
the step response seen from the first chunk after an event is the same whatever the phase of the event.
"""

from dataclasses import dataclass

import numpy as np

HALF_POWER = 2**-0.5
ROUNDING = 1e-12  # a sum of a thousand weights misses a threshold that it reaches exactly by less than this
_OVERSAMPLING = 32  # grid points per 1/K of frequency; the response is a polynomial of degree K-1


@dataclass(frozen=True)
class InnovationFilter:
    """The linear, R-periodic filter between innovations and executed commands.

    Attributes:
        impulse: (K,) weight of the innovation that is j steps old, mean over replan phases; sums to 1.
        replan_interval: R [control steps].
        latency: d, age of the newest chunk that is used [control steps].
    """

    impulse: np.ndarray
    replan_interval: int
    latency: int

    @property
    def last_age(self) -> int:
        """Age of the oldest chunk that is still used [control steps]."""
        return len(self.impulse) - 1

    def phase_weights(self, phase: int) -> tuple[np.ndarray, np.ndarray]:
        """Ages [control steps] and weights (sum 1) of the chunks used where ``t mod R == phase``."""
        ages = ages_used(phase, len(self.impulse), self.replan_interval, self.latency)
        return ages, self.replan_interval * self.impulse[ages]

    def response(self, frequency: np.ndarray | float) -> np.ndarray:
        """``H(f) = sum_j h_j exp(-2 pi i f j)`` at frequencies f [cycles/step].

        For R > 1 it is the component at the innovation's own frequency, the mean over phases.
        """
        frequency = np.atleast_1d(np.asarray(frequency, dtype=np.float64))
        return np.exp(-2j * np.pi * np.outer(frequency, np.arange(len(self.impulse)))) @ self.impulse

    @property
    def bandwidth(self) -> float | None:
        """First frequency [cycles/step] at which half the power is gone (-3 dB); None if there is none."""
        from scipy.optimize import brentq

        points = 1 << (_OVERSAMPLING * len(self.impulse) - 1).bit_length()
        below = np.flatnonzero(np.abs(np.fft.rfft(self.impulse, points)) < HALF_POWER)
        if not below.size:
            return None
        low, high = (below[0] - 1) / points, below[0] / points
        return brentq(lambda f: abs(self.response(f)[0]) - HALF_POWER, low, high, xtol=1e-15)  # pyright: ignore[reportReturnType]

    @property
    def group_delay(self) -> float:
        """Delay of slow innovations, ``sum_j j h_j`` [control steps]."""
        return float(np.arange(len(self.impulse)) @ self.impulse)

    @property
    def effective_samples(self) -> float:
        """By how much averaging would divide the variance of independent chunk errors (they are not)."""
        return float(1 / (self.replan_interval * np.square(self.impulse).sum()))

    def mean_step(self) -> np.ndarray:
        """(K,) share of a step executed n control steps after it, mean over the phase it falls in."""
        return np.minimum(self.impulse.cumsum(), 1.0)

    def step(self, wait: int) -> np.ndarray:
        """Share of a step executed n control steps after it, (wait + K rounded up to a multiple of R,).

        Args:
            wait: control steps from the event to the next inference, 0 (best) .. R-1 (worst).
        """
        blocks = -(-len(self.impulse) // self.replan_interval)
        padded = np.zeros(blocks * self.replan_interval)
        padded[: len(self.impulse)] = self.impulse
        shares = self.replan_interval * padded.reshape(blocks, -1).cumsum(0)
        return np.concatenate([np.zeros(wait), np.minimum(shares.ravel(), 1.0)])

    def full_response(self, wait: int) -> int:
        """Control steps after which the last chunk from before the event is gone: exactly 100 %."""
        return self.last_age - self.replan_interval + 1 + wait


def ages_used(step: int, chunk_size: int, replan_interval: int, latency: int) -> np.ndarray:
    """Ages [control steps], ascending, of the chunks that may be used at ``step``."""
    return np.arange(latency + (step - latency) % replan_interval, chunk_size, replan_interval)


def settle_steps(shares: np.ndarray, share: float) -> int:
    """The step from which on a step response stays at ``share`` or above; its length if it never does."""
    below = np.flatnonzero(shares < share - ROUNDING)
    return int(below[-1]) + 1 if below.size else 0


def chunk_weights(n_chunks: int, weighting: str, decay: float) -> np.ndarray:
    """Weights of n overlapping chunks, newest first, sum 1.

    Args:
        n_chunks: how many.
        weighting: ``act`` (Zhao et al. 2023: old chunks weigh most), ``recency`` or ``uniform``.
        decay: m R, the exponent between two consecutive chunks; ratios never exceed 1, so none overflows.
    """
    weights = np.exp(-(0.0 if weighting == "uniform" else decay) * np.arange(n_chunks))
    return (weights[::-1] if weighting == "act" else weights) / weights.sum()


def ensemble_filter(
    chunk_size: int, replan_interval: int, weighting: str, coeff: float, latency: int
) -> InnovationFilter:
    """Weighted mean of all chunks that cover the current step.

    For R = 1: ``h_j = rho^j (1 - rho) / (rho^d - rho^K)`` with ``rho = exp(m)`` (act) or ``exp(-m)``
    (recency), ``1 / (K - d)`` (uniform).

    Args:
        chunk_size: K, used actions per chunk [control steps]; at least R + d.
        replan_interval: R [control steps].
        weighting: see `chunk_weights`.
        coeff: m >= 0 [1/control step].
        latency: d [control steps].
    """
    impulse = np.zeros(chunk_size)
    for phase in range(replan_interval):
        ages = ages_used(phase, chunk_size, replan_interval, latency)
        impulse[ages] = chunk_weights(len(ages), weighting, coeff * replan_interval) / replan_interval
    return InnovationFilter(impulse, replan_interval, latency)


def newest_chunk_filter(replan_interval: int, latency: int, fade: int = 0) -> InnovationFilter:
    """The newest chunk, blended in over ``fade`` steps.

    Without a fade: a dead time of d .. d + R - 1 steps and no averaging. With one, a chunk of age j takes the
    share ``min(1, (j - d + 1) / (fade + 1))`` of what the older ones left it.
    """
    impulse = np.zeros(latency + fade + replan_interval)
    for phase in range(replan_interval):
        ages = ages_used(phase, len(impulse), replan_interval, latency)
        shares = np.minimum((ages - latency + 1) / (fade + 1), 1.0)
        left = np.cumprod(np.concatenate([[1.0], 1 - shares[:-1]]))
        impulse[ages] = shares * left / replan_interval
    return InnovationFilter(impulse, replan_interval, latency)


def start_up_step(steady: InnovationFilter, weighting: str, coeff: float, event: int) -> np.ndarray:
    """(K,) share of a step executed n control steps after it, where few old chunks hold it back.

    Args:
        steady: the ensemble once K steps have passed.
        weighting: see `chunk_weights`.
        coeff: m [1/control step].
        event: step of the event since the reset; a chunk computed there sees it.
    """
    interval, latency = steady.replan_interval, steady.latency
    shares = np.zeros(len(steady.impulse))
    for delay in range(latency, len(shares)):
        covering = min(event + delay + 1, len(shares))
        ages = ages_used(event + delay, covering, interval, latency)
        shares[delay] = chunk_weights(len(ages), weighting, coeff * interval)[ages <= delay].sum()
    return np.minimum(shares, 1.0)
