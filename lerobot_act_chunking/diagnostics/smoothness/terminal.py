"""The comparison on a terminal: tables with one row per source."""

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from lerobot_act_chunking.data.dimension_names import is_hand
from lerobot_act_chunking.diagnostics.core.lag import LagGroup
from lerobot_act_chunking.diagnostics.core.noise_floor import listed
from lerobot_act_chunking.diagnostics.smoothness.report import (
    MotionMeasures,
    SmoothnessComparison,
    SmoothnessReport,
)


def print_report(report: SmoothnessComparison, console: Console) -> None:
    """Print both tables, and what to know about each source."""
    console.print(motion_table(report.sources), chunk_table(report.sources))
    for note in notes(report.sources):
        console.print(f"- {note}", style="dim", markup=False, highlight=False)


def motion_table(reports: Sequence[SmoothnessReport]) -> Table:
    """Smoothness of the arms, as commanded and as achieved."""
    table = _table(
        "motion of the arms: commanded | achieved (↑ higher, ↓ lower is smoother)",
        ("rms jerk ↓\nstd/s³", "LDLJ ↑\n", "SPARC ↑\n", "above 5 Hz ↓\n%", "lag\nms"),
    )
    for report in reports:
        table.add_row(
            report.name,
            _both(report, "rms_jerk", 0),
            _both(report, "log_dimensionless_jerk", 1),
            _both(report, "sparc", 2),
            _both(report, "energy_above_5_hz", 2, 100.0),
            _lags(report),
        )
    return table


def chunk_table(reports: Sequence[SmoothnessReport]) -> Table:
    """What chunking did to the commands of the arms: jumps at boundaries, disagreement."""
    table = _table(
        "chunks (1 is seamless, more is a jump; ↓ lower is better)",
        (
            "success\n%",
            "calls per\nepisode",
            "boundary\nratio 1",
            "accel.\nratio 1",
            "boundary\nto plan 1",
            "disagree-\nment ↓ std",
        ),
    )
    for report in reports:
        arms = report.commanded.arms
        success = None if report.successes is None else report.successes / report.episodes
        table.add_row(
            report.name,
            _number(success, 1, 100.0),
            _number(report.network_calls_per_episode, 1),
            _number(arms.boundary_ratio, 2),
            _number(arms.boundary_acceleration_ratio, 2),
            _number(report.boundary_to_plan_ratio.get("arms"), 2),
            _number(report.disagreement and report.disagreement.mean_arms, 3),
        )
    return table


def notes(reports: Sequence[SmoothnessReport]) -> list[str]:
    """What to know about each source: which joints lag together, and what does not count."""
    lines = []
    for report in reports:
        own = [_group(group, report) for group in report.lag_groups] if len(report.lag_groups) > 1 else []
        unknown = [
            name
            for name in report.moving
            if report.achieved is not None and report.tracking_lag_s[name] is None
        ]
        if unknown and report.lag_groups:
            own.append(f"Lag unknown, motion and command are too unlike: {listed(unknown)}.")
        lines += [f"{report.name}: {note}" for note in (*own, *report.notes)]
    return lines


def _group(group: LagGroup, report: SmoothnessReport) -> str:
    correlations = [report.lag_correlation[joint] or 0.0 for joint in group.joints]
    return (
        f"Lag {_span(group)} ms, correlation {min(correlations):.2f} to {max(correlations):.2f}: "
        f"{listed(group.joints)}."
    )


def _span(group: LagGroup) -> str:
    ends = dict.fromkeys(f"{1000 * seconds:.0f}" for seconds in (group.shortest_s, group.longest_s))
    return " to ".join(ends)


def _lags(report: SmoothnessReport) -> str:
    """Of the arms, or of each group of joints that lag alike."""
    lag = report.tracking_lag_s.get("arms")
    if lag is not None:
        return _number(lag, 0, 1000.0)
    arms = [group for group in report.lag_groups if any(not is_hand(joint) for joint in group.joints)]
    return ", ".join(map(_span, arms)) if arms else "-"


def _table(title: str, columns: Sequence[str]) -> Table:
    table = Table(title=title, title_justify="left")
    table.add_column("source", overflow="fold")
    for column in columns:
        table.add_column(column, justify="right")
    return table


def _both(report: SmoothnessReport, name: str, digits: int, factor: float = 1.0) -> str:
    signals = [report.commanded, report.achieved]
    arms: list[MotionMeasures | None] = [signal and signal.arms for signal in signals]
    return " | ".join(_number(measures and getattr(measures, name), digits, factor) for measures in arms)


def _number(value: float | None, digits: int, factor: float = 1.0) -> str:
    return "-" if value is None else f"{factor * value:.{digits}f}"
