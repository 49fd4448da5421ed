"""What a scripted expert of any robot can be asked for, and the noise that disturbs it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from lerobot_act_chunking.errors import ConfigurationError

_NOISE_CORRELATION = 0.2  # width [s] of the filter on white noise: slow enough for a robot to follow

Ranges = Mapping[str, tuple[float, float, str]]
"""Lowest value, highest value and unit of each option of an expert."""


@dataclass(frozen=True)
class ExpertOptions:
    """How an expert moves; the defaults are smooth, noise-free and never pause.

    Attributes:
        speed: pace as a multiple of the nominal one.
        waypoint_noise: standard deviation [m] of the shift of each way-point the task leaves free; grasps and
            hand-overs stay exact.
        action_noise: standard deviation of time-correlated noise on the executed arm actions, in their own
            unit (ALOHA: rad, Fetch: share of the largest action); the recorded actions stay clean.
        dwell: pause [s] at each grasp and each release.
    """

    speed: float = 1.0
    waypoint_noise: float = 0.0
    action_noise: float = 0.0
    dwell: float = 0.0

    def check(self, ranges: Ranges) -> None:
        """Refuse what the expert with these ``ranges`` cannot do.

        Raises:
            ConfigurationError: a value outside its range.
        """
        for name, (low, high, unit) in ranges.items():
            value = getattr(self, name)
            if not (math.isfinite(value) and low <= value <= high):
                raise ConfigurationError(f"expert option {name}={value} is outside {low} .. {high} {unit}")


def correlated_noise(
    shape: tuple[int, int], scale: float, rng: np.random.Generator, *, period: float
) -> np.ndarray:
    """Gaussian noise (T, D) of standard deviation ``scale``, smooth along steps of ``period`` [s]."""
    width = _NOISE_CORRELATION / period
    # Wrapping around keeps the variance even at both ends.
    smooth = gaussian_filter1d(rng.standard_normal(shape), width, axis=0, mode="wrap")
    # A Gaussian filter of width w leaves white noise a variance of 1 / (2 sqrt(pi) w).
    return scale * np.sqrt(2 * np.sqrt(np.pi) * width) * smooth
