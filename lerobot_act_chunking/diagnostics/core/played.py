"""What is written down of an episode that a policy has played."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lerobot_act_chunking.diagnostics.core import motion_metrics
from lerobot_act_chunking.diagnostics.core.rollouts import Ending, Rollout
from lerobot_act_chunking.diagnostics.core.trajectories import UndefinedMeasureError

STILL_SHARE = 0.02
"""Of the range that a number covers in an episode: who moves less stands still."""
STALLED_S = 1.0
"""Who stands still for so long at the end of a failed episode has stalled."""


@dataclass(frozen=True)
class Episode:
    """One episode.

    Attributes:
        seed: of the environment.
        success: whether any step was a success, as LeRobot counts.
        rules: what the last step said of every success rule of the environment.
        sum_reward: over all steps.
        max_reward: of all steps.
        length: control steps.
        ending: terminated or truncated by the environment, or cut at its ``episode_length``.
        failure: what went wrong, where the environment can tell.
        still_s: how long nothing had moved when it ended [s].
        network_calls: while it ran.
        log_dimensionless_jerk: of the commands' speed, without grippers; None if nothing moves.
        sparc: spectral arc length of the same.
        instead: what the environment named in place of the success key; None where the key was there.
    """

    seed: int
    success: bool
    rules: Mapping[str, bool]
    sum_reward: float
    max_reward: float
    length: int
    ending: Ending
    failure: str | None
    still_s: float
    network_calls: int
    log_dimensionless_jerk: float | None
    sparc: float | None
    instead: Sequence[str] | None = None

    @property
    def stalled(self) -> bool:
        """Whether it failed and nothing moved any more."""
        return not self.success and self.still_s >= STALLED_S

    @property
    def label(self) -> str | None:
        """In a few words why it failed: the environment's own, or how it ended; None for a success."""
        if self.success:
            return None
        if self.failure:
            return self.failure
        if self.ending == "terminated":
            return "terminated"
        return "stalled" if self.stalled else "timeout"


def describe(rollout: Rollout, arms: Sequence[int]) -> Episode:
    """What is written down of a rollout.

    Args:
        rollout: the episode.
        arms: the dimensions of the action that are no grippers or hands.
    """
    speed = motion_metrics.speed(rollout.commands[:, list(arms)], rollout.dt)
    return Episode(
        seed=rollout.seed,
        success=bool(rollout.success),
        rules=dict(rollout.rules),
        sum_reward=float(rollout.rewards.sum()),
        max_reward=float(rollout.rewards.max()),
        length=len(rollout.commands),
        ending=rollout.ending,
        failure=rollout.failure,
        still_s=standstill(rollout),
        network_calls=len(rollout.inferences),
        log_dimensionless_jerk=_defined(motion_metrics.log_dimensionless_jerk, speed, rollout.dt),
        sparc=_defined(motion_metrics.spectral_arc_length, speed, rollout.dt),
        instead=rollout.instead,
    )


def standstill(rollout: Rollout) -> float:
    """How long nothing had moved when the episode ended [s].

    By the robot's state where it was observed, else by the commands. A number stands still while it stays
    within `STILL_SHARE` of the range that it covers in this episode.
    """
    motion = rollout.states if rollout.states.size else rollout.commands
    reach = STILL_SHARE * np.ptp(motion, axis=0)
    near = (np.abs(motion - motion[-1]) <= reach).all(1)
    moved = np.flatnonzero(~near)
    return float((len(motion) - 1 - (moved[-1] + 1 if len(moved) else 0)) * rollout.dt)


def _defined(measure: Any, speed: np.ndarray, dt: float) -> float | None:
    try:
        return measure(speed, dt)
    except UndefinedMeasureError:
        return None
