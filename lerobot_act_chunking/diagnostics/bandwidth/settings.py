"""What is asked: which execution, at which rate, and what the task needs of it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from act_chunking_runtime.number_checks import check_positive

BANDWIDTH_MARGIN = 3.0  # a disturbance at a third of the -3 dB frequency passes with more than 90 %
GAIN_MARGIN = 2.0  # 6 dB
LATE = 0.5
"""Share of a disturbance that may be missed; a moving average misses 46 % at a third of its bandwidth."""


@dataclass(frozen=True)
class Limits:
    """What the task asks for; None asks for nothing.

    Attributes:
        disturbance_hz: disturbances up to this frequency [Hz] must be followed.
        max_settle_s: time [s] within which 90 % of a correction must be executed, whatever the replan phase.
        loop_gain: gain of the visual loop [1/control step]: how much of an error one step's command removes.

    Raises:
        ConfigurationError: a value that is not positive.
    """

    disturbance_hz: float | None = None
    max_settle_s: float | None = None
    loop_gain: float | None = None

    def __post_init__(self) -> None:
        check_positive(**vars(self))

    @property
    def given(self) -> bool:
        """Whether there is anything to judge."""
        return any(value is not None for value in vars(self).values())

    def thresholds(self) -> dict[str, float]:
        """The least and largest acceptable figures."""
        thresholds = {}
        if self.disturbance_hz is not None:
            thresholds["min_bandwidth_hz"] = BANDWIDTH_MARGIN * self.disturbance_hz
        if self.max_settle_s is not None:
            thresholds["max_settle_90_s"] = self.max_settle_s
        if self.loop_gain is not None:
            thresholds["min_k_max"] = GAIN_MARGIN * self.loop_gain
        return thresholds


@dataclass(frozen=True)
class Push:
    """A push in simulation; the fields are those of `push.study_push`."""

    task: str
    push_m: float = 0.03
    push_step: int = 40
    episodes: int = 10
    seed: int = 1000


@dataclass(frozen=True)
class Settings:
    """What to diagnose.

    Attributes:
        checkpoint: folder or repo id; None for ACT's own execution.
        execution: fields of `ExecutionSettings` that win over the checkpoint's; None leaves one as it is.
        limits: what the task asks for.
        fps: control steps per second; None for those of the push or of the checkpoint's training, else 50.
        push: ask the same question in simulation, too.
    """

    checkpoint: str | None = None
    execution: Mapping[str, Any] = field(default_factory=dict)
    limits: Limits = field(default_factory=Limits)
    fps: float | None = None
    push: Push | None = None
