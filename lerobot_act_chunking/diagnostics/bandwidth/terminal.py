"""The diagnosis on a terminal."""

from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.diagnostics.bandwidth.closed_form import ClosedForm, PhaseSettle, StartUp
from lerobot_act_chunking.diagnostics.bandwidth.report import BandwidthReport
from lerobot_act_chunking.diagnostics.core.terminal import print_verdict

if TYPE_CHECKING:
    from lerobot_act_chunking.diagnostics.bandwidth.push import PushStudy


def print_report(report: BandwidthReport, console: Console) -> None:
    """Print the figures, the check, what to know about them, and the verdict."""
    console.print(_title(report), soft_wrap=True)
    table = Table(show_header=False, box=None, pad_edge=False)
    for row in _rows(report):
        table.add_row(*row)
    console.print(table)
    if report.push is not None:
        console.print(_push_table(report.push))
    for note in report.notes:
        console.print(f"[dim]- {note}[/]", highlight=False)
    print_verdict(report, console)


def describe(settings: ExecutionSettings) -> str:
    """An execution in one line."""
    parts = [f"{settings.execution}, K={settings.n_action_steps}, R={settings.replan_interval}"]
    if settings.execution in ("ensemble", "adaptive"):
        parts.append(f"{settings.ensemble_weighting} weights, m={settings.temporal_ensemble_coeff:g}")
    if settings.execution == "crossfade":
        parts.append(f"fade over {settings.crossfade_steps}")
    if settings.smoothing_steps > 1:
        parts.append(f"mean over {settings.smoothing_steps}")
    if settings.latency_steps:
        parts.append(f"d={settings.latency_steps}")
    return ", ".join(parts)


def _push_table(push: "PushStudy") -> Table:
    title = (
        f"{push.task}, object pushed {push.push_m:g} m at step {push.push_step}, {len(push.seeds)} episodes"
    )
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for name in ("execution", "90 % after", "formula", "pushed", "not pushed"):
        table.add_column(name)
    for response in push.responses:
        settles = response.settle_90_steps, response.expected_settle_90_steps
        table.add_row(
            describe(response.settings),
            *("-" if steps is None else f"{steps / push.fps:.2f} s" for steps in settles),
            f"{response.successes}/{len(push.seeds)}",
            f"{response.undisturbed_successes}/{len(push.seeds)}",
        )
    return table


def _title(report: BandwidthReport) -> str:
    source = report.source
    origin = f" [dim]({source.policy_type}, {source.checkpoint})[/]" if source.checkpoint else ""
    return f"[bold]{describe(source.settings)}, at {report.fps:g} Hz[/]{origin}"


def _rows(report: BandwidthReport) -> list[tuple[str, str]]:
    rows = [] if report.figures is None else _figures(report.figures, report.fps)
    rows += [
        (
            f"90 % of a step of {step.size:g} sd",
            f"{_steps(step.settle_90_steps, report.fps)} (measured, just before an inference)",
        )
        for step in report.measured_steps
    ]
    rows.append(("network calls", f"{report.fps / report.source.settings.replan_interval:.3g} per second"))
    if report.agreement is not None:
        rows.append(("measured", _measured(report)))
    if report.at_disturbance is not None:
        at = report.at_disturbance
        text = f"gain {at.gain:.2f}, phase {at.phase_deg:.0f} deg, {at.missed:.0%} left uncorrected"
        rows.append((f"at {at.frequency_hz:g} Hz", text))
    return rows + _advice(report)


def _figures(figures: ClosedForm, fps: float) -> list[tuple[str, str]]:
    rows = [
        ("bandwidth (-3 dB)", _bandwidth(figures)),
        ("delay", _steps(figures.group_delay_steps, fps)),
    ]
    best, worst = figures.phases["best"], figures.phases["worst"]
    if best == worst:
        rows.append(("63 / 90 / 100 % of a step", _settle(best, fps)))
    else:
        rows.append(("63 / 90 / 100 %, best phase", _settle(best, fps)))
        rows.append(("... mean over phases", _settle(figures.phases["mean"], fps)))
        rows.append(("... worst phase", _settle(worst, fps)))
    if figures.start_up:
        rows.append(("90 % after a reset", _start_up(figures.start_up)))
    return [
        *rows,
        ("averages", f"{figures.effective_samples:.1f} independent chunks' worth"),
        ("loop gain limit", f"{figures.k_max:.3g} per step"),
    ]


def _start_up(rows: list[StartUp]) -> str:
    """Settle times up to the first event that finds the steady state."""
    steady = rows[-1].settle_90_steps
    early = [f"{row.settle_90_steps} steps at step {row.event_step}" for row in rows]
    kept = next(i for i, row in enumerate(rows) if row.settle_90_steps == steady)
    return ", ".join([*early[:kept], f"{early[kept]} and later"])


def _bandwidth(figures: ClosedForm) -> str:
    if figures.bandwidth_hz is None:
        return f"no limit up to {figures.nyquist_hz:g} Hz, half the inference rate"
    return f"{figures.bandwidth_hz:.3g} Hz"


def _settle(settle: PhaseSettle, fps: float) -> str:
    times = settle.settle_63_steps, settle.settle_90_steps, settle.settle_100_steps
    steps, seconds = (
        " / ".join(f"{time:g}" for time in times),
        " / ".join(f"{time / fps:.2f}" for time in times),
    )
    return f"{steps} steps ({seconds} s)"


def _steps(steps: float, fps: float) -> str:
    return f"{steps:.4g} steps ({steps / fps:.2f} s)"


def _measured(report: BandwidthReport) -> str:
    agreement = report.agreement
    assert agreement is not None  # noqa: S101  (its caller has looked)
    return (
        f"executor agrees to {agreement.step_error:.0e} (steps in every phase), "
        f"{agreement.plan_error:.0e} (plan), {agreement.noise_error:.0e} (noise)"
    )


def _advice(report: BandwidthReport) -> list[tuple[str, str]]:
    if report.advice is None:
        return []
    best = report.advice.recommended
    if best is None:
        return [("recommended", "nothing meets these limits with this latency: make inference faster")]
    bandwidth = "no bandwidth limit" if best.bandwidth_hz is None else f"{best.bandwidth_hz:.3g} Hz"
    figures = f"{bandwidth}, 90 % in {best.settle_90_s:.2f} s, averages {best.effective_samples:.1f}"
    return [("recommended", f"{best.flags}\n{figures}")]
