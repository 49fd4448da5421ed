"""The diagnosis as a picture."""

from pathlib import Path
from typing import Any

import numpy as np

from lerobot_act_chunking.diagnostics.bandwidth.closed_form import filter_for
from lerobot_act_chunking.diagnostics.bandwidth.filter import InnovationFilter
from lerobot_act_chunking.diagnostics.bandwidth.report import BandwidthReport
from lerobot_act_chunking.diagnostics.bandwidth.terminal import describe

_FLOOR_DB = -40.0
_POINTS = 2000
_LOWEST_DEG = -720.0
_UNIFORM = 0.443  # -3 dB frequency times length of a long moving average


def plot_report(report: BandwidthReport, path: Path) -> Path:
    """Bode diagram, step responses, impulse response and other sizes, into a PNG; returns its path.

    After a push its answers are drawn in their place.
    """
    from matplotlib.figure import Figure

    if report.push is not None:
        from lerobot_act_chunking.diagnostics.bandwidth.push_plot import plot_push

        return plot_push(report.push, path)

    kernel = filter_for(report.source.settings)
    figure = Figure(figsize=(11, 8) if kernel else (7, 4.5), layout="constrained")
    figure.suptitle(f"Response to innovations: {describe(report.source.settings)}, {report.fps:g} Hz")
    if kernel is None:
        _draw_measured_steps(figure.subplots(), report)
    else:
        gain, step, phase, impulse, bandwidths, settles = figure.subplots(3, 2).ravel()
        _draw_gain(gain, report, kernel)
        _draw_phase(phase, report, kernel)
        _draw_steps(step, report, kernel)
        _draw_impulse(impulse, kernel)
        _draw_sweep(bandwidths, settles, report)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    return path


def _frequencies(kernel: InnovationFilter) -> np.ndarray:
    """Cycles per step, from well below the filter's corner to the highest there is."""
    return np.geomspace(min(0.01, 0.02 / len(kernel.impulse)), 0.5, _POINTS)


def _draw_gain(ax: Any, report: BandwidthReport, kernel: InnovationFilter) -> None:
    frequency = _frequencies(kernel)
    ax.semilogx(frequency * report.fps, _decibels(kernel.response(frequency)), label="closed form")
    measured = report.agreement
    if measured is not None:
        shown = np.unique(np.geomspace(1, len(measured.frequency) - 1, 40).round().astype(int))
        ax.plot(
            measured.frequency[shown] * report.fps,
            _decibels(measured.response[shown]),
            "o",
            markersize=3,
            color="tab:orange",
            label="measured on the executor",
        )
    bandwidth = report.figures and report.figures.bandwidth_hz
    if bandwidth is not None:
        ax.axvline(bandwidth, color="0.6", linewidth=0.8, linestyle="--")
        ax.annotate(f"{bandwidth:.3g} Hz", (bandwidth, _FLOOR_DB), (4, 4), textcoords="offset points")
    _mark_disturbance(ax, report)
    span = frequency[0] * report.fps, report.fps / 2
    ax.set(xlabel="frequency [Hz]", ylabel="gain |H| [dB]", xlim=span, ylim=(_FLOOR_DB, 3))
    ax.legend(loc="lower left", fontsize=8)
    ax.grid(alpha=0.3)
    _label_logarithmic(ax.xaxis)


def _draw_phase(ax: Any, report: BandwidthReport, kernel: InnovationFilter) -> None:
    """Two turns at most: where the phase goes on from there, hardly anything is left."""
    frequency = _frequencies(kernel)
    phase = np.degrees(np.unwrap(np.angle(kernel.response(frequency))))
    ax.semilogx(frequency * report.fps, phase)
    _mark_disturbance(ax, report)
    low = max(_LOWEST_DEG, float(phase.min()))
    span = frequency[0] * report.fps, report.fps / 2
    ax.set(xlabel="frequency [Hz]", ylabel="phase of H [deg]", xlim=span, ylim=(low - 20, 20))
    ax.set_yticks(np.arange(0, low - 1, -180))
    ax.grid(alpha=0.3)
    _label_logarithmic(ax.xaxis)


def _mark_disturbance(ax: Any, report: BandwidthReport) -> None:
    if report.limits.disturbance_hz is not None:
        ax.axvline(
            report.limits.disturbance_hz, color="black", linewidth=1, linestyle=":", label="disturbance"
        )


def _draw_steps(ax: Any, report: BandwidthReport, kernel: InnovationFilter) -> None:
    """Responses to a step in the best and the worst replan phase, and the mean over all."""
    worst = kernel.replan_interval - 1
    end = kernel.last_age + max(2, len(kernel.impulse) // 20)
    curves = {"mean over phases": (kernel.mean_step(), "tab:blue")}
    if worst:
        curves["best phase: just before an inference"] = (kernel.step(0), "tab:green")
        curves["worst phase: just after one"] = (kernel.step(worst), "tab:red")
    else:
        curves = {"command": curves["mean over phases"]}
    for label, (shares, colour) in curves.items():
        padded = np.ones(end + 1)
        padded[: len(shares)] = shares[: end + 1]
        time = np.arange(-1, end + 1) / report.fps
        ax.step(time, np.concatenate([[0], padded]), where="post", label=label, color=colour)
    ax.axhline(0.9, color="0.6", linewidth=0.8, linestyle="--")
    if report.limits.max_settle_s is not None:
        ax.axvline(report.limits.max_settle_s, color="black", linewidth=1, linestyle=":", label="allowed")
    ax.set(xlabel="time since the event [s]", ylabel="share of the correction", ylim=(-0.03, 1.05))
    ax.legend(loc="lower right", fontsize=8)
    ax.grid(alpha=0.3)


def _draw_impulse(ax: Any, kernel: InnovationFilter) -> None:
    ax.bar(np.arange(len(kernel.impulse)), kernel.impulse, width=1.0, color="tab:blue")
    ax.axvline(
        kernel.group_delay, color="tab:red", linewidth=1, label=f"delay {kernel.group_delay:.1f} steps"
    )
    ax.set(xlabel="age of the chunk [control steps]", ylabel="weight (mean over phases)")
    ax.margins(y=0.25)
    ax.legend(loc="upper center", fontsize=8)


def _draw_sweep(bandwidths: Any, settles: Any, report: BandwidthReport) -> None:
    """Bandwidth and settle time of the same execution at other sizes."""
    settings = report.source.settings
    ensemble = settings.execution == "ensemble"
    label = "chunk length K [control steps]" if ensemble else "replan interval R [control steps]"
    present = settings.n_action_steps if ensemble else settings.replan_interval
    limited = [(point.size, point.bandwidth_hz) for point in report.sweep if point.bandwidth_hz is not None]
    if limited:
        sizes, hertz = zip(*limited, strict=True)
        bandwidths.loglog(sizes, hertz, ".-", label="this execution")
        bandwidths.loglog(
            sizes,
            _UNIFORM * report.fps / np.array(sizes),
            "--",
            color="0.5",
            label=f"{_UNIFORM} fps / size (moving average)",
        )
        bandwidths.legend(fontsize=8)
    slow = [
        (point.size, point.settle_90_steps / report.fps) for point in report.sweep if point.settle_90_steps
    ]
    settles.loglog(*zip(*slow, strict=True), ".-")
    for ax, what in ((bandwidths, "bandwidth [Hz]"), (settles, "90 % of a step [s]")):
        ax.axvline(present, color="0.6", linewidth=1, linestyle="--")
        ax.set(xlabel=label, ylabel=what)
        ax.grid(alpha=0.3)
        _label_logarithmic(ax.xaxis)
        _label_logarithmic(ax.yaxis)


def _draw_measured_steps(ax: Any, report: BandwidthReport) -> None:
    for step in report.measured_steps:
        time = np.arange(-1, len(step.shares)) / report.fps
        ax.step(time, [0, *step.shares], where="post", label=f"{step.size:g} sd of the chunks' differences")
    ax.axhline(0.9, color="0.6", linewidth=0.8, linestyle="--")
    ax.set(xlabel="time since the event [s]", ylabel="share of the step executed (measured)")
    ax.legend(title="step of", loc="lower right", fontsize=8)
    ax.grid(alpha=0.3)


def _label_logarithmic(axis: Any) -> None:
    """Ticks at 1, 2 and 5 times powers of ten, as plain numbers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _decibels(response: np.ndarray) -> np.ndarray:
    return 20 * np.log10(np.maximum(np.abs(response), 10 ** (2 * _FLOOR_DB / 20)))
