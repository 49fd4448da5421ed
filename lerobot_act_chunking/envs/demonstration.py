"""What a scripted expert of any robot can be asked for, and the noise that disturbs it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np
from scipy.ndimage import gaussian_filter1d

from lerobot_act_chunking.errors import ConfigurationError

_NOISE_CORRELATION = 0.2  # width [s] of the filter on white noise: slow enough for a robot to follow

_PACE_SLOWNESS = 2.5  # the pace wanders this many times more slowly than the hand
_TREMOR_BAND = (6.0, 11.0)  # [Hz]; physiological tremor of the hand is at 8 to 12 (Elble & Koller 1990)

Ranges = Mapping[str, tuple[float, float, str]]
"""Lowest value, highest value and unit of each option of an expert."""


@dataclass(frozen=True)
class ExpertOptions:
    """How an expert moves in one episode; the defaults are smooth, noise-free and never pause.

    Attributes:
        speed: pace as a multiple of the nominal one.
        waypoint_noise: standard deviation [m] of the shift of each way-point the task leaves free; grasps and
            hand-overs stay exact.
        action_noise: standard deviation of time-correlated noise on the executed arm actions, in their own
            unit (ALOHA: rad, Fetch: share of the largest action); the recorded actions stay clean.
        dwell: pause [s] at each grasp and each release.
        dwell_after: pause [s] right after each grasp and release, and before two parts meet.
        dwell_spread: standard deviation of the logarithm of each pause's length.
        pace_change: standard deviation of the logarithm of the pace, which wanders within the episode.
        idle_start: rest [s] before the first motion.
        idle_end: rest [s] after the last motion, as far as the episode lasts.
        detour: shift [m] of the free way-points to one side (world y); the sign is the side.
        overshoot: by how much free movements go too far before they are corrected, as a share of them.
        hand_noise: standard deviation of time-correlated noise of the hand, in the unit of the actions; it is
            executed and recorded.
        tremor: the same between 6 and 11 Hz.
        missed_grasps: how many times the fingers close on nothing before they grasp, 0 or 1.
        one_arm_first: 1 where the second arm begins only when the first has grasped.
        constant_speed: 1 where movements start and stop at once, go at constant speed in between, and nothing
            moves in a pause, as programmed robots often do.
        stepwise: 1 where each movement begins when the one before it has ended, as ACT's scripted
            demonstrations do.
        latency: how much later [s] than it is recorded a command reaches the robot.
        dropped_frames: share of the control steps that the recording misses.
    """

    speed: float = 1.0
    waypoint_noise: float = 0.0
    action_noise: float = 0.0
    dwell: float = 0.0
    dwell_after: float = 0.0
    dwell_spread: float = 0.0
    pace_change: float = 0.0
    idle_start: float = 0.0
    idle_end: float = 0.0
    detour: float = 0.0
    overshoot: float = 0.0
    hand_noise: float = 0.0
    tremor: float = 0.0
    missed_grasps: int = 0
    one_arm_first: int = 0
    constant_speed: int = 0
    stepwise: int = 0
    latency: float = 0.0
    dropped_frames: float = 0.0

    def settings(self) -> dict[str, float]:
        """As a recording keeps them: the first four always, the others, which are younger, where set."""
        kept = ("speed", "waypoint_noise", "action_noise", "dwell")
        return {
            entry.name: value
            for entry in fields(self)
            if (value := getattr(self, entry.name)) != entry.default or entry.name in kept
        }

    def pause(self, seconds: float, rng: np.random.Generator) -> float:
        """The length [s] of one pause that lasts ``seconds`` on average; draws only where they are uneven."""
        if not (seconds and self.dwell_spread):
            return seconds
        return seconds * float(np.exp(self.dwell_spread * rng.standard_normal()))

    def hand(self, shape: tuple[int, int], rng: np.random.Generator, *, period: float) -> np.ndarray:
        """What the hand adds (T, D) to the actions: noise and tremor; draws nothing where both are 0."""
        noise = np.zeros(shape)
        if self.hand_noise > 0:
            noise += correlated_noise(shape, self.hand_noise, rng, period=period)
        if self.tremor > 0:
            noise += tremor(shape, self.tremor, rng, period=period)
        return noise

    def check(self, ranges: Ranges) -> None:
        """Refuse what the expert with these ``ranges`` cannot do.

        Raises:
            ConfigurationError: a value outside its range.
        """
        for name, (low, high, unit) in ranges.items():
            value = getattr(self, name)
            if not (math.isfinite(value) and low <= value <= high):
                raise ConfigurationError(f"expert option {name}={value} is outside {low} .. {high} {unit}")


def minimum_jerk(phase: np.ndarray) -> np.ndarray:
    """The minimum-jerk profile from 0 to 1 (Flash & Hogan 1985), constant outside 0 .. 1."""
    phase = np.clip(phase, 0.0, 1.0)
    return phase**3 * (10 - 15 * phase + 6 * phase**2)


def correlated_noise(
    shape: tuple[int, int], scale: float, rng: np.random.Generator, *, period: float
) -> np.ndarray:
    """Gaussian noise (T, D) of standard deviation ``scale``, smooth along steps of ``period`` [s]."""
    width = _NOISE_CORRELATION / period
    # Wrapping around keeps the variance even at both ends.
    smooth = gaussian_filter1d(rng.standard_normal(shape), width, axis=0, mode="wrap")
    # A Gaussian filter of width w leaves white noise a variance of 1 / (2 sqrt(pi) w).
    return scale * np.sqrt(2 * np.sqrt(np.pi) * width) * smooth


def tremor(shape: tuple[int, int], scale: float, rng: np.random.Generator, *, period: float) -> np.ndarray:
    """Gaussian noise (T, D) of standard deviation ``scale`` in the band of a hand's tremor."""
    from scipy.signal import butter, sosfilt  # as slow to import as all of this module

    settle = round(1 / period)
    filters = butter(2, _TREMOR_BAND, "bandpass", fs=1 / period, output="sos")
    response = sosfilt(filters, np.eye(1, 4 * settle)[0])
    filtered = sosfilt(filters, rng.standard_normal((settle + shape[0], shape[1])), axis=0)
    return scale / np.linalg.norm(response) * np.asarray(filtered)[settle:]


def wandering_pace(times: np.ndarray, change: float, rng: np.random.Generator) -> np.ndarray:
    """Factors (T,) of the pace at evenly spaced ``times`` [s]; ``change`` is their logarithm's deviation."""
    noise = correlated_noise((len(times), 1), change, rng, period=(times[1] - times[0]) / _PACE_SLOWNESS)
    return np.exp(noise[:, 0])
