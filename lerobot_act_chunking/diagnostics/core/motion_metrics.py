"""How smooth a motion is: textbook measures of one trajectory, or of several taken together.

Trajectories are ``(T, D)``, one row per control step of ``dt`` seconds. A measure that a trajectory does not
define raises `UndefinedMeasureError` with the reason; none returns NaN.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy import ndimage, signal

from lerobot_act_chunking.diagnostics.core.trajectories import JITTER_HZ, Trajectories, UndefinedMeasureError

IDLE_SPEED = 0.02
"""Share of the peak speed below which a joint or an arm counts as standing still."""
IDLE_SECONDS = 0.2
"""How long that must last to be a pause and not a turning point."""
SPARC_MAX_HZ = 10.0
SPARC_THRESHOLD = 0.05
SPARC_PADDING = 4
SPECTRUM_SECONDS = 2.56
"""Length of the windows whose spectra are averaged: a resolution of 0.4 Hz."""


def speed(trajectory: np.ndarray, dt: float) -> np.ndarray:
    """Length of the velocity, ``(T - 1,)`` [units/s]."""
    return np.linalg.norm(np.diff(trajectory, axis=0), axis=1) / dt


def moving(speed: np.ndarray, dt: float) -> np.ndarray:
    """Which samples ``(T,)`` belong to motion: all but pauses, slow for at least `IDLE_SECONDS`."""
    slow = speed <= IDLE_SPEED * speed.max(initial=0.0)
    # Opening keeps the runs of at least this many samples.
    return ~ndimage.binary_opening(slow, np.ones(math.ceil(IDLE_SECONDS / dt), bool))


def rms_jerk(trajectories: Trajectories, dt: float) -> float:
    """Root mean square of the third derivative over all samples and dimensions [units/s³]; lower is smoother.

    Each trajectory has at least four samples.
    """
    jerks = np.concatenate([np.diff(trajectory, 3, axis=0) for trajectory in trajectories])
    return float(np.sqrt(np.square(jerks).mean()) / dt**3)


def log_dimensionless_jerk(speed: np.ndarray, dt: float) -> float:
    """LDLJ of a speed profile ``(T,)``, ``-ln(D³/v_peak² ∫ v''² dt)``; higher is smoother.

    Balasubramanian et al. 2015, "On the analysis of movement smoothness", equation for LDLJ-V; a minimum-jerk
    reach has -ln 204.8 = -5.32. The integral and the duration D leave pauses out, or waiting at the end of an
    episode would count as jerk.

    Raises:
        UndefinedMeasureError: no motion, or one of less than three samples.
    """
    in_motion = _moving_or_raise(speed, dt)
    curvature = np.diff(speed, 2) / dt**2
    integral = np.square(curvature[in_motion[1:-1]]).sum() * dt
    if integral == 0.0:
        raise UndefinedMeasureError("the speed never bends: the logarithm of no jerk is infinite")
    duration = in_motion.sum() * dt
    return float(-np.log(duration**3 / speed.max() ** 2 * integral))


def spectral_arc_length(speed: np.ndarray, dt: float) -> float:
    """SPARC of a speed profile ``(T,)``: minus the length of its spectrum's outline; nearer to 0 is smoother.

    Balasubramanian et al. 2015: magnitude relative to the one at 0 Hz, up to the last frequency at or below
    10 Hz whose magnitude reaches 0.05, frequencies scaled to [0, 1]. A minimum-jerk reach has about -1.4.
    Pauses are cut out, or they would dominate the spectrum.

    Raises:
        UndefinedMeasureError: no motion, or one of less than three samples.
    """
    profile = speed[_moving_or_raise(speed, dt)]
    n_fft = 2 ** (math.ceil(math.log2(len(profile))) + SPARC_PADDING)
    magnitude = np.abs(np.fft.rfft(profile, n_fft))
    magnitude = magnitude[np.fft.rfftfreq(n_fft, dt) <= SPARC_MAX_HZ] / magnitude[0]
    outline = magnitude[: np.flatnonzero(magnitude >= SPARC_THRESHOLD)[-1] + 1]
    steps = len(outline) - 1
    return float(-np.hypot(1 / steps, np.diff(outline)).sum())


def velocity_spectrum(trajectories: Trajectories, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Power density of each dimension's velocity, averaged over time: frequencies [Hz] ``(F,)``, ``(F, D)``.

    Of the velocity and not the position, whose slow drift would hide everything else; Welch's method with
    Hann windows, whose leakage does not reach from slow motion to fast.
    Each trajectory has at least three samples.
    """
    window = round(SPECTRUM_SECONDS / dt)
    powers, weights = [], []
    for trajectory in trajectories:
        velocity = np.diff(trajectory, axis=0) / dt
        _, power = signal.welch(
            velocity,
            fs=1 / dt,
            nperseg=min(window, len(velocity)),
            nfft=window,
            detrend=False,  # pyright: ignore[reportArgumentType]  (SciPy's documented "leave it")
            axis=0,
        )
        powers.append(power)
        weights.append(len(velocity))
    return np.fft.rfftfreq(window, dt), np.average(powers, axis=0, weights=weights)


def high_frequency_share(frequencies: np.ndarray, power: np.ndarray) -> float:
    """Share of the velocity's power ``(F, D)`` above 5 Hz, in [0, 1]; lower is smoother.

    Raises:
        UndefinedMeasureError: nothing moves, or the control rate does not reach beyond 5 Hz.
    """
    if frequencies[-1] <= JITTER_HZ:
        raise UndefinedMeasureError(f"the control rate shows no frequency above {JITTER_HZ:g} Hz")
    if not power.any():
        raise UndefinedMeasureError("nothing moves")
    return float(power[frequencies > JITTER_HZ].sum() / power.sum())


def per_episode(
    measure: Callable[[np.ndarray, float], float], speeds: Sequence[np.ndarray], dt: float
) -> list[float | None]:
    """A measure of each speed profile, None where it is undefined."""
    values: list[float | None] = []
    for profile in speeds:
        try:
            values.append(measure(profile, dt))
        except UndefinedMeasureError:
            values.append(None)
    return values


def median(values: Sequence[float | None]) -> float:
    """Median of the defined values.

    Raises:
        UndefinedMeasureError: there are none.
    """
    defined = [value for value in values if value is not None]
    if not defined:
        raise UndefinedMeasureError("undefined in every episode: nothing moves")
    return float(np.median(defined))


def _moving_or_raise(speed: np.ndarray, dt: float) -> np.ndarray:
    in_motion = moving(speed, dt)
    if in_motion.sum() < 3:
        raise UndefinedMeasureError("nothing moves")
    return in_motion
