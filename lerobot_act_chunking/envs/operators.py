"""People who demonstrate: scripted experts with the habits in which operators of real robots differ.

An operator has habits that stay, and draws from them how one episode goes. Where the figures come from:

- Movements between way-points are minimum-jerk strokes (Flash & Hogan 1985); what goes too far is brought
  back by a second, smaller one (Meyer et al. 1988).
- Tremor: 8 to 12 Hz (Elble & Koller 1990).
- Recordings of people with leader arms rest 0.7 to 1.9 s at both ends, pause 0 to 0.5 times an episode, for
  up to 1.8 s, and their robots follow 0.07 to 0.13 s late.
- Their episodes differ in length by a factor of up to 2.5.

Rests are shorter here than in those recordings, because an episode of the simulated tasks ends after 8 s.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from lerobot_act_chunking.envs.demonstration import ExpertOptions, Ranges
from lerobot_act_chunking.errors import unknown_choice

_FURTHEST = 2.0  # [standard deviations] from a habit that an episode may be


@dataclass(frozen=True)
class Operator:
    """The habits of one person.

    Noise is given as a share of the most that the robot's expert bears, since actions have other units on
    another robot.

    Attributes:
        pace: mean pace as a multiple of the expert's nominal one.
        pace_spread: standard deviation of its logarithm from episode to episode.
        pace_change: the same within an episode.
        dwell: mean pause [s] before each grasp and release.
        dwell_after: mean pause [s] after each.
        dwell_spread: standard deviation of the logarithm of each pause.
        idle_start: mean rest [s] before the first motion.
        idle_end: mean rest [s] after the last.
        waypoint_noise: standard deviation [m] of free way-points.
        detour: how far [m] free way-points lie to one side.
        left_share: share of the episodes in which that side is the left one (+y).
        overshoot: mean share by which free movements go too far.
        hand_noise: slow noise of the hand, as a share of the most that the expert bears.
        tremor: fast noise of the hand, as a share of the most that the expert bears.
        miss_rate: share of the episodes with a grasp that has to be repeated.
        one_arm_share: share of the episodes in which one arm moves after the other.
        constant_speed: 1 where movements start and stop at once, go at constant speed in between, and nothing
            moves in a pause.
        stepwise: 1 where each movement begins when the one before it has ended.
        latency: how much later [s] than it is recorded a command reaches the robot.
        dropped_frames: share of the control steps that the recording misses.
    """

    pace: float = 1.0
    pace_spread: float = 0.0
    pace_change: float = 0.0
    dwell: float = 0.0
    dwell_after: float = 0.0
    dwell_spread: float = 0.0
    idle_start: float = 0.0
    idle_end: float = 0.0
    waypoint_noise: float = 0.0
    detour: float = 0.0
    left_share: float = 1.0
    overshoot: float = 0.0
    hand_noise: float = 0.0
    tremor: float = 0.0
    miss_rate: float = 0.0
    one_arm_share: float = 0.0
    constant_speed: int = 0
    stepwise: int = 0
    latency: float = 0.0
    dropped_frames: float = 0.0

    def episode(self, rng: np.random.Generator, ranges: Ranges) -> ExpertOptions:
        """How the next episode goes.

        Args:
            rng: source of what differs between episodes.
            ranges: of what the robot's expert bears; what lies beyond is drawn in.
        """

        def varied(mean: float, spread: float) -> float:
            return mean * float(np.exp(spread * np.clip(rng.standard_normal(), -_FURTHEST, _FURTHEST)))

        drawn: dict[str, Any] = {
            "speed": varied(self.pace, self.pace_spread),
            "pace_change": self.pace_change,
            "dwell": varied(self.dwell, self.dwell_spread),
            "dwell_after": varied(self.dwell_after, self.dwell_spread),
            "dwell_spread": self.dwell_spread,
            "idle_start": varied(self.idle_start, _IDLE_SPREAD),
            "idle_end": varied(self.idle_end, _IDLE_SPREAD),
            "waypoint_noise": self.waypoint_noise,
            "detour": self.detour if rng.random() < self.left_share else -self.detour,
            "overshoot": varied(self.overshoot, _OVERSHOOT_SPREAD),
            "hand_noise": self.hand_noise * ranges["hand_noise"][1],
            "tremor": self.tremor * ranges["tremor"][1],
            "missed_grasps": int(rng.random() < self.miss_rate),
            "one_arm_first": int(rng.random() < self.one_arm_share),
            "constant_speed": self.constant_speed,
            "stepwise": self.stepwise,
            "latency": self.latency,
            "dropped_frames": self.dropped_frames,
        }
        return ExpertOptions(**{name: _within(value, ranges[name]) for name, value in drawn.items()})


_IDLE_SPREAD, _OVERSHOOT_SPREAD = 0.5, 0.4


def _within(value: Any, limits: tuple[float, float, str]) -> Any:
    low, high, _ = limits
    return min(max(value, low), high)


OPERATORS: Mapping[str, Operator] = {
    # The expert as it is: never rests, never errs.
    "steady": Operator(),
    # Takes time at every contact.
    "unhurried": Operator(
        pace=0.95,
        pace_spread=0.04,
        dwell=0.25,
        dwell_after=0.12,
        dwell_spread=0.2,
        idle_start=0.2,
        idle_end=0.3,
        hand_noise=0.05,
    ),
    # Quick, goes too far and comes back.
    "brisk": Operator(
        pace=1.25, pace_spread=0.07, waypoint_noise=0.008, overshoot=0.06, hand_noise=0.05, idle_end=0.1
    ),
    # Stops and goes; looks before every grasp, for longer or shorter.
    "hesitant": Operator(
        pace=1.2,
        pace_spread=0.05,
        pace_change=0.2,
        dwell=0.35,
        dwell_after=0.1,
        dwell_spread=0.35,
        idle_start=0.5,
        idle_end=0.3,
        hand_noise=0.05,
    ),
    # One arm after the other, and waits before every contact until all is still.
    "cautious": Operator(
        pace=1.45,
        pace_spread=0.04,
        dwell=0.45,
        dwell_after=0.2,
        dwell_spread=0.25,
        idle_start=0.2,
        idle_end=0.2,
        one_arm_share=1.0,
        hand_noise=0.03,
    ),
    # A hand that is not calm.
    "shaky": Operator(
        pace=1.05,
        pace_spread=0.05,
        dwell=0.1,
        waypoint_noise=0.01,
        hand_noise=0.1,
        tremor=0.1,
        idle_start=0.1,
    ),
    # Misses grasps and tries again; the recording misses frames.
    "clumsy": Operator(
        pace=1.15,
        pace_spread=0.06,
        dwell=0.1,
        dwell_spread=0.3,
        overshoot=0.05,
        hand_noise=0.06,
        miss_rate=0.35,
        dropped_frames=0.02,
    ),
    # Sees the robot late, over a poor connection.
    "remote": Operator(
        pace=1.05,
        pace_spread=0.05,
        dwell=0.2,
        dwell_after=0.1,
        dwell_spread=0.3,
        idle_start=0.3,
        idle_end=0.2,
        latency=0.1,
        dropped_frames=0.05,
    ),
    # Comes from either side.
    "two_sided": Operator(
        pace=1.1,
        pace_spread=0.08,
        waypoint_noise=0.01,
        detour=0.08,
        left_share=0.5,
        dwell=0.05,
        hand_noise=0.03,
    ),
    # No person but a program: constant speed, and the same long standstills in every episode.
    "programmed": Operator(pace=1.3, constant_speed=1, dwell=0.8, dwell_after=0.9, idle_end=0.2),
    # Another program, which does the tasks another way: from way-point to way-point, with inclined grippers.
    "stepwise": Operator(stepwise=1, dwell=0.2, dwell_after=0.2, idle_end=0.2),
    # A person who does them so, and rests where the program does, for longer or shorter.
    "methodical": Operator(
        pace=1.1,
        pace_spread=0.05,
        waypoint_noise=0.01,
        dwell=0.3,
        dwell_after=0.2,
        dwell_spread=0.3,
        idle_start=0.3,
        idle_end=0.2,
        hand_noise=0.02,
        stepwise=1,
    ),
}
"""The people, by name."""


def get_operator(name: str) -> Operator:
    """The person called ``name``.

    Raises:
        ConfigurationError: no such person.
    """
    if name not in OPERATORS:
        raise unknown_choice("operator", name, OPERATORS)
    return OPERATORS[name]
