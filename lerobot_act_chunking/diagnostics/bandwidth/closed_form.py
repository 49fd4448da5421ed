"""The figures of an execution's innovation filter, in steps, seconds and hertz."""

import math
from dataclasses import dataclass

import numpy as np

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.diagnostics.bandwidth.filter import (
    InnovationFilter,
    ensemble_filter,
    newest_chunk_filter,
    settle_steps,
    start_up_step,
)
from lerobot_act_chunking.diagnostics.bandwidth.stability import gain_limit

ONE_TIME_CONSTANT = 1 - math.exp(-1)
SHARES = {"settle_63_steps": ONE_TIME_CONSTANT, "settle_90_steps": 0.9}
_SWEEP_POINTS = 24


@dataclass(frozen=True)
class PhaseSettle:
    """Response to a step that falls in one replan phase [control steps after the event]."""

    dead_time_steps: float
    settle_63_steps: float
    settle_90_steps: float
    settle_100_steps: float


@dataclass(frozen=True)
class PhaseWeights:
    """Weights of the chunks executed at steps t with ``t mod R == phase``, newest first; they sum to 1."""

    phase: int
    ages: list[int]
    weights: list[float]


@dataclass(frozen=True)
class StartUp:
    """Settle times [control steps] of an event ``event_step`` steps after a reset."""

    event_step: int
    settle_63_steps: int
    settle_90_steps: int


@dataclass(frozen=True)
class SweepPoint:
    """The filter at another size: chunk length for ensembles, replan interval otherwise [control steps]."""

    size: int
    bandwidth_hz: float | None
    settle_90_steps: int


@dataclass(frozen=True)
class ClosedForm:
    """What the filter does, exactly.

    Attributes:
        bandwidth_hz: -3 dB frequency; None if innovations of every frequency keep more than half their power.
        nyquist_hz: half the rate of inferences, above which innovations are not even seen correctly.
        group_delay_steps: delay of slow innovations.
        settle_63_steps: steps until the mean response over all replan phases has done 63 % of a step, 1 - 1/e
        settle_90_steps: ... 90 % ...
        settle_100_steps: ... all of it: the last chunk from before the event is gone in every phase.
        effective_samples: factor by which independent errors of chunks would lose variance.
        k_max: largest stable loop gain [1/control step], see `gain_limit`.
        impulse_response: weight of the innovation j steps old, j = 0, 1, ..., mean over replan phases.
        phases: settle times of an event just before an inference (``best``) and just after (``worst``), and
            their mean over all phases.
        phase_impulse_responses: the weights in each replan phase.
        start_up: settle times soon after a reset, for ensembles.
    """

    bandwidth_hz: float | None
    nyquist_hz: float
    group_delay_steps: float
    settle_63_steps: int
    settle_90_steps: int
    settle_100_steps: int
    effective_samples: float
    k_max: float
    impulse_response: list[float]
    phases: dict[str, PhaseSettle]
    phase_impulse_responses: list[PhaseWeights]
    start_up: list[StartUp]


def closed_form(settings: ExecutionSettings, fps: float) -> ClosedForm | None:
    """The figures of ``settings`` at ``fps`` steps per second; None if no linear filter describes it."""
    kernel = filter_for(settings)
    if kernel is None:
        return None
    mean = kernel.mean_step()
    return ClosedForm(
        bandwidth_hz=in_hertz(kernel.bandwidth, fps),
        nyquist_hz=fps / (2 * kernel.replan_interval),
        group_delay_steps=kernel.group_delay,
        **{name: settle_steps(mean, share) for name, share in SHARES.items()},
        settle_100_steps=kernel.last_age,
        effective_samples=kernel.effective_samples,
        k_max=gain_limit(kernel),
        impulse_response=kernel.impulse.tolist(),
        phases=_phases(kernel),
        phase_impulse_responses=[_phase_weights(kernel, phase) for phase in range(kernel.replan_interval)],
        start_up=_start_up(settings, kernel),
    )


def filter_for(settings: ExecutionSettings, size: int | None = None) -> InnovationFilter | None:
    """The filter of ``settings``; None for modes whose weights depend on what the chunks say.

    Args:
        settings: how chunks are executed.
        size: another n_action_steps for an ensemble, another replan interval for the other modes.
    """
    interval, latency = settings.replan_interval, settings.latency_steps
    if settings.execution == "ensemble":
        weighting, coeff = ensemble_weights(settings)
        return ensemble_filter(size or settings.n_action_steps, interval, weighting, coeff, latency)
    if settings.execution in ("open_loop", "receding", "crossfade"):
        return newest_chunk_filter(size or interval, latency, settings.crossfade_steps or 0)
    return None


def ensemble_weights(settings: ExecutionSettings) -> tuple[str, float]:
    """Weighting and coefficient m of an ensemble; its settings always hold both."""
    return settings.ensemble_weighting or "act", settings.temporal_ensemble_coeff or 0.0


def sweep(settings: ExecutionSettings, fps: float) -> list[SweepPoint]:
    """The same filter at other sizes, up to twice this one."""
    smallest, present = 1, settings.replan_interval
    if settings.execution == "ensemble":
        smallest, present = settings.replan_interval + settings.latency_steps, settings.n_action_steps
    sizes = np.geomspace(smallest, max(2 * present, 20), _SWEEP_POINTS).round().astype(int)
    sizes = np.union1d(sizes, [present])
    kernels = [(int(size), filter_for(settings, int(size))) for size in sizes]
    return [
        SweepPoint(size, in_hertz(kernel.bandwidth, fps), settle_steps(kernel.mean_step(), 0.9))
        for size, kernel in kernels
        if kernel is not None
    ]


def in_hertz(frequency: float | None, fps: float) -> float | None:
    """A frequency [cycles/step] in Hz."""
    return None if frequency is None else frequency * fps


def _phases(kernel: InnovationFilter) -> dict[str, PhaseSettle]:
    worst = kernel.replan_interval - 1
    return {"best": _settle(kernel, 0), "mean": _settle(kernel, worst / 2), "worst": _settle(kernel, worst)}


def _settle(kernel: InnovationFilter, wait: float) -> PhaseSettle:
    """Settle times of an event ``wait`` steps before an inference: everything happens that much later."""
    shares = kernel.step(0)
    return PhaseSettle(
        dead_time_steps=kernel.latency + wait,
        **{name: settle_steps(shares, share) + wait for name, share in SHARES.items()},
        settle_100_steps=kernel.full_response(0) + wait,
    )


def _phase_weights(kernel: InnovationFilter, phase: int) -> PhaseWeights:
    ages, weights = kernel.phase_weights(phase)
    return PhaseWeights(phase, ages.tolist(), weights.tolist())


def _start_up(settings: ExecutionSettings, kernel: InnovationFilter) -> list[StartUp]:
    """Events after 1 step, a tenth, a quarter, half and all of a chunk, each on the next inference."""
    if settings.execution != "ensemble":
        return []
    weighting, coeff = ensemble_weights(settings)
    interval, size = kernel.replan_interval, len(kernel.impulse)
    events = sorted({-(-max(1, size // part) // interval) * interval for part in (size, 10, 4, 2, 1)})
    rows = []
    for event in events:
        shares = start_up_step(kernel, weighting, coeff, event)
        rows.append(StartUp(event, **{name: settle_steps(shares, share) for name, share in SHARES.items()}))
    return rows
