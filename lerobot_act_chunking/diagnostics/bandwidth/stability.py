"""How hard a loop may be driven through delayed, averaged commands."""

import numpy as np

from lerobot_act_chunking.diagnostics.bandwidth.filter import InnovationFilter

_OVERSAMPLING = 64
_CLOSE = 0.9


def gain_limit(kernel: InnovationFilter) -> float:
    """Largest stable gain k [1/control step] of the loop ``x(t+1) = x(t) - k a(t)``.

    Here ``a`` is the executed command when every chunk demands the correction ``x`` it observed, for its
    whole length. That is the slowest honest policy: one that plans its own correction tolerates more.

    Only what is observed at replans matters, and over one interval the loop adds
    ``-k sum_i g_i x(t - i R)`` with g the sums of R consecutive entries of R h. So the limit is that of the
    filter g/R at the replan rate, divided by R; there, Nyquist's criterion gives it exactly: the smallest k
    at which ``k G(z) / (z - 1) = -1`` somewhere on the unit circle.
    """
    interval = kernel.replan_interval
    blocks = -(-len(kernel.impulse) // interval)
    padded = np.zeros(blocks * interval)
    padded[: len(kernel.impulse)] = kernel.impulse
    return _gain_limit_every_step(padded.reshape(blocks, interval).sum(1)) / interval


def _gain_limit_every_step(impulse: np.ndarray) -> float:
    from scipy.optimize import brentq

    ages = np.arange(len(impulse))

    def loop(frequency: float) -> complex:
        z = np.exp(2j * np.pi * frequency)
        return complex(impulse @ z**-ages / (z - 1))

    points = 1 << (_OVERSAMPLING * len(impulse) - 1).bit_length()
    frequency = np.arange(1, points // 2) / points
    curve = np.fft.rfft(impulse, points)[1:-1] / (np.exp(2j * np.pi * frequency) - 1)
    crossings = np.flatnonzero(np.signbit(curve.imag[1:]) != np.signbit(curve.imag[:-1]))
    # At the filter's nulls rounding makes crossings too; only those furthest to the left matter.
    depths = curve.real[crossings]
    values = [float(impulse @ (-1.0) ** ages) / -2]  # at half the sampling rate z - 1 = -2
    for i in crossings[depths < _CLOSE * min(depths, default=0.0)]:
        # Half a grid step more on both sides, in case the crossing is on a grid point.
        low, high = frequency[i] - 0.5 / points, frequency[i + 1] + 0.5 / points
        values.append(loop(brentq(lambda f: loop(f).imag, low, high, xtol=1e-15)).real)  # pyright: ignore[reportArgumentType]
    return -1 / min(values)
