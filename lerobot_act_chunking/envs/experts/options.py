"""What an expert can be asked for, and what it answers."""

import math
from dataclasses import dataclass

import numpy as np

from lerobot_act_chunking.errors import ConfigurationError

# Outside these ranges the experts fail too often to demonstrate anything.
_SPEED = (0.7, 1.5)
_WAYPOINT_NOISE = (0.0, 0.03)
_ACTION_NOISE = (0.0, 0.05)
_DWELL = (0.0, 1.0)


@dataclass(frozen=True)
class ExpertOptions:
    """How an expert moves; the defaults are smooth, noise-free and never pause.

    Attributes:
        speed: pace as a multiple of the nominal one.
        waypoint_noise: standard deviation [m] of the shift of each way-point the task leaves free; grasps and
            hand-overs stay exact.
        action_noise: standard deviation [rad] of time-correlated noise on the executed arm targets.
        dwell: pause [s] at each grasp and each release.

    Raises:
        ConfigurationError: a value outside its range.
    """

    speed: float = 1.0
    waypoint_noise: float = 0.0
    action_noise: float = 0.0
    dwell: float = 0.0

    def __post_init__(self) -> None:
        _check_range("speed", self.speed, _SPEED, unit="times the nominal pace")
        _check_range("waypoint_noise", self.waypoint_noise, _WAYPOINT_NOISE, unit="m")
        _check_range("action_noise", self.action_noise, _ACTION_NOISE, unit="rad")
        _check_range("dwell", self.dwell, _DWELL, unit="s")


@dataclass(frozen=True)
class ExpertPlan:
    """A whole episode at 50 Hz, rows in the order of ``JOINT_NAMES``: arm targets [rad], grippers 0 .. 1.

    Attributes:
        actions: (T, 14) clean targets, what a dataset records as the action.
        commands: (T, 14) what is executed: ``actions`` plus the action noise, as in DART (Laskey et al.
            2017): the recorded action always leads back from the disturbed state.
    """

    actions: np.ndarray
    commands: np.ndarray


def _check_range(name: str, value: float, allowed: tuple[float, float], unit: str) -> None:
    low, high = allowed
    if not (math.isfinite(value) and low <= value <= high):
        raise ConfigurationError(f"expert option {name}={value} is outside {low} .. {high} {unit}")
