"""What is known about the smoothness of each source of episodes, as plain data."""

from dataclasses import asdict, dataclass, field
from typing import Any, ClassVar

from lerobot_act_chunking.diagnostics.core.lag import LagGroup
from lerobot_act_chunking.diagnostics.core.report import Judgement, Report
from lerobot_act_chunking.diagnostics.smoothness.settings import Settings


@dataclass(frozen=True)
class MotionMeasures:
    """Measures of one joint or of a group, over all episodes; None where undefined.

    ``rms_jerk`` is in the joint's unit/s³, of a group in standard deviations/s³. ``log_dimensionless_jerk``
    and ``sparc`` are medians over episodes.
    """

    rms_jerk: float | None
    log_dimensionless_jerk: float | None
    sparc: float | None
    boundary_ratio: float | None
    boundary_acceleration_ratio: float | None
    energy_above_5_hz: float | None


@dataclass(frozen=True)
class SignalReport:
    """What was commanded, or what the robot did: arm joints together, grippers together, each joint."""

    arms: MotionMeasures
    grippers: MotionMeasures
    joints: dict[str, MotionMeasures]


@dataclass(frozen=True)
class DisagreementReport:
    """Rms difference between predictions for the same step [standard deviations], by the chunks' age."""

    ages_s: list[float]
    arms: list[float]
    grippers: list[float] | None
    joints: dict[str, list[float]]
    pairs: list[int]
    mean_arms: float


@dataclass(frozen=True)
class Curves:
    """What the plot draws, all of the arms.

    Attributes:
        frequencies_hz: of the spectra.
        commanded_power: density of the commanded velocity's power [standard deviations²/s²/Hz].
        achieved_power: of the achieved velocity; None without positions.
        boundary_profile: median commanded step from 10 steps before a chunk's first to 10 after it, over the
            median step; None if there is no such boundary.
        log_dimensionless_jerk: of each episode's command; None where nothing moves.
    """

    frequencies_hz: list[float]
    commanded_power: list[float]
    achieved_power: list[float] | None
    boundary_profile: list[float] | None
    log_dimensionless_jerk: list[float | None]


@dataclass(frozen=True)
class SmoothnessReport:
    """Smoothness of one source; ``undefined`` gives the reason for every None, by its path.

    Attributes:
        moving: joints that the groups consist of; the others stand still, tremble or are parked.
        tracking_lag_s: of the groups and of each joint; None where it is unreliable, or where the joints of a
            group differ.
        lag_correlation: of each joint's velocities at its lag; None where that is unreliable.
        lag_groups: joints that lag alike.
        notes: what to know about the figures.
    """

    name: str
    episodes: int
    steps: int
    dt: float
    successes: int | None
    network_calls_per_episode: float | None
    boundaries_per_episode: float
    commanded: SignalReport
    achieved: SignalReport | None
    boundary_to_plan_ratio: dict[str, float | None]
    moving: list[str]
    tracking_lag_s: dict[str, float | None]
    lag_correlation: dict[str, float | None]
    lag_groups: list[LagGroup]
    disagreement: DisagreementReport | None
    curves: Curves
    undefined: dict[str, str]
    notes: list[str]


@dataclass(frozen=True, kw_only=True)
class SmoothnessComparison(Report):
    """Smoothness of every source, in the same units. It judges none of them: it always passes.

    Attributes:
        requested: the settings of the diagnosis.
        sources: one report for each.
    """

    tool: ClassVar[str] = "act-chunking smoothness"
    requested: Settings
    sources: list[SmoothnessReport]
    judgement: Judgement = field(default_factory=lambda: Judgement("pass", []))

    def content(self) -> dict[str, Any]:
        """The settings they were made with, and the sources, free of NaN."""
        settings = {**asdict(self.requested.evaluation), "replan_interval": self.requested.replan_interval}
        return {"settings": settings, "sources": [asdict(source) for source in self.sources]}
