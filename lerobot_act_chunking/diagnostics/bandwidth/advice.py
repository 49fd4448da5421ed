"""Which settings would give a task what it needs from the filter."""

from dataclasses import dataclass

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.diagnostics.bandwidth.closed_form import (
    ensemble_weights,
    in_hertz,
)
from lerobot_act_chunking.diagnostics.bandwidth.filter import (
    InnovationFilter,
    ensemble_filter,
    newest_chunk_filter,
    settle_steps,
)
from lerobot_act_chunking.diagnostics.bandwidth.settings import LATE, Limits
from lerobot_act_chunking.diagnostics.bandwidth.stability import gain_limit

_INTERVALS = (1, 2, 5, 10, 20, 25, 50, 100, 200, 250, 500)
_WEIGHTS = (("act", 0.01), ("uniform", 0.0), ("recency", 0.01), ("recency", 0.05), ("recency", 0.1))


@dataclass(frozen=True)
class Candidate:
    """Settings that meet the limits, with their figures; settle time of the worst replan phase."""

    execution: str
    replan_interval: int
    n_action_steps: int
    ensemble_weighting: str | None
    temporal_ensemble_coeff: float | None
    effective_samples: float
    bandwidth_hz: float | None
    settle_90_s: float
    inferences_per_s: float

    @property
    def flags(self) -> str:
        """The options of ``lerobot-eval`` that select these settings."""
        names = ("execution", "replan_interval", "n_action_steps")
        flags = [f"--policy.{name}={getattr(self, name)}" for name in names]
        if self.ensemble_weighting is not None:
            flags.append(f"--policy.ensemble_weighting={self.ensemble_weighting}")
            flags.append(f"--policy.temporal_ensemble_coeff={self.temporal_ensemble_coeff:g}")
        return " ".join(flags)


@dataclass(frozen=True)
class Advice:
    """Settings that meet the limits: one per replan interval, and the one to take.

    ``recommended`` averages most among those that need no more inferences than the present settings, or else
    needs the fewest. None: nothing meets the limits, a chunk's latency alone is too much.
    """

    recommended: Candidate | None
    candidates: list[Candidate]


def recommend(settings: ExecutionSettings, limits: Limits, fps: float) -> Advice:
    """The settings that average most and meet the limits, for chunks as long as these or shorter.

    Averaging more than the limits allow costs reaction; averaging less costs smoothness for nothing.
    """
    longest = settings.chunk_size - settings.latency_steps
    intervals = sorted({r for r in (*_INTERVALS, settings.replan_interval) if r <= longest})
    candidates = [c for c in (_best(settings, interval, limits, fps) for interval in intervals) if c]
    affordable = [c for c in candidates if c.replan_interval >= settings.replan_interval]
    if affordable:
        return Advice(max(affordable, key=lambda c: c.effective_samples), candidates)
    return Advice(candidates[-1] if candidates else None, candidates)


def _best(settings: ExecutionSettings, interval: int, limits: Limits, fps: float) -> Candidate | None:
    """The candidate for one replan interval that averages most, if any meets the limits."""
    latency, longest = settings.latency_steps, settings.chunk_size
    own = ensemble_weights(settings) if settings.execution == "ensemble" else _WEIGHTS[0]
    found: list[Candidate] = []
    for weighting, coeff in dict.fromkeys((own, *_WEIGHTS)):
        size = _longest_window(interval, weighting, coeff, latency, longest, limits, fps)
        if size is not None:
            kernel = ensemble_filter(size, interval, weighting, coeff, latency)
            found.append(_candidate(kernel, "ensemble", size, weighting, coeff, fps))
    newest = newest_chunk_filter(interval, latency)
    if not found and _meets(newest, limits, fps):
        mode = "open_loop" if interval == longest else "receding"
        found.append(_candidate(newest, mode, longest, None, None, fps))
    return max(found, key=lambda candidate: candidate.effective_samples, default=None)


def _longest_window(
    interval: int, weighting: str, coeff: float, latency: int, longest: int, limits: Limits, fps: float
) -> int | None:
    """The most actions per chunk with which an ensemble meets the limits, by bisection: longer is slower."""

    def meets(size: int) -> bool:
        return _meets(ensemble_filter(size, interval, weighting, coeff, latency), limits, fps)

    shortest = interval + latency + 1  # with fewer, nothing overlaps
    if shortest > longest or not meets(shortest):
        return None
    good, bad = shortest, longest + 1
    while bad - good > 1:
        middle = (good + bad) // 2
        good, bad = (middle, bad) if meets(middle) else (good, middle)
    return good


def _meets(kernel: InnovationFilter, limits: Limits, fps: float) -> bool:
    thresholds = limits.thresholds()
    if "max_settle_90_s" in thresholds and _worst_settle_s(kernel, fps) > thresholds["max_settle_90_s"]:
        return False
    if limits.disturbance_hz is not None:
        bandwidth = in_hertz(kernel.bandwidth, fps)
        if bandwidth is not None and bandwidth < thresholds["min_bandwidth_hz"]:
            return False
        if abs(1 - kernel.response(limits.disturbance_hz / fps)[0]) > LATE:
            return False
    return "min_k_max" not in thresholds or gain_limit(kernel) >= thresholds["min_k_max"]


def _worst_settle_s(kernel: InnovationFilter, fps: float) -> float:
    return (settle_steps(kernel.step(0), 0.9) + kernel.replan_interval - 1) / fps


def _candidate(
    kernel: InnovationFilter,
    execution: str,
    size: int,
    weighting: str | None,
    coeff: float | None,
    fps: float,
) -> Candidate:
    return Candidate(
        execution=execution,
        replan_interval=kernel.replan_interval,
        n_action_steps=size,
        ensemble_weighting=weighting,
        temporal_ensemble_coeff=coeff,
        effective_samples=kernel.effective_samples,
        bandwidth_hz=in_hertz(kernel.bandwidth, fps),
        settle_90_s=_worst_settle_s(kernel, fps),
        inferences_per_s=fps / kernel.replan_interval,
    )
