"""Reports as tables for the terminal, one row per source."""

from collections.abc import Sequence

from rich.table import Table

from lerobot_act_chunking.diagnostics.smoothness.report import MotionMeasures, SmoothnessReport


def motion_table(reports: Sequence[SmoothnessReport]) -> Table:
    """Smoothness of the arms, as commanded and as achieved."""
    table = _table(
        "motion of the arms: commanded | achieved (↑ higher, ↓ lower is smoother)",
        ("rms jerk ↓\nstd/s³", "LDLJ ↑\n", "SPARC ↑\n", "above 5 Hz ↓\n%", "lag\nms"),
    )
    for report in reports:
        lag = report.tracking_lag_s["arms"]
        table.add_row(
            report.name,
            _both(report, "rms_jerk", 0),
            _both(report, "log_dimensionless_jerk", 1),
            _both(report, "sparc", 2),
            _both(report, "energy_above_5_hz", 2, 100.0),
            _number(lag, 0, 1000.0),
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
            _number(report.boundary_to_plan_ratio["arms"], 2),
            _number(report.disagreement and report.disagreement.mean_arms, 3),
        )
    return table


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
