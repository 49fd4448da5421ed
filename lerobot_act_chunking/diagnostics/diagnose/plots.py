"""The diagnosis as a picture."""

from pathlib import Path
from typing import Any

from lerobot_act_chunking.diagnostics.diagnose.effects import LEVEL
from lerobot_act_chunking.diagnostics.diagnose.report import DiagnoseReport


def plot_report(report: DiagnoseReport, path: Path) -> Path:
    """What share of the failures each intervention repairs, into a PNG; returns its path."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 2.0 + 0.32 * max(1, len(report.effects))), layout="constrained")
    ax = figure.subplots()
    if report.effects:
        _draw_effects(ax, report)
    else:
        ax.axis("off")
        ax.text(0, 0.5, "no intervention was tried", transform=ax.transAxes)
    named = " and ".join(each.name for each in report.causes) or "no cause named"
    failures = report.failures
    told = "" if failures is None else f", {failures.successes} of {failures.episodes} episodes fail"
    ax.set_title(f"{report.verdict}: {named}\n{report.policy_type} on {report.where}{told}", fontsize=10)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    return path


def _draw_effects(ax: Any, report: DiagnoseReport) -> None:
    for place, (effect, p) in enumerate(report.effects):
        low, high = effect.recovered.exact_interval
        colour = "tab:green" if p < LEVEL and effect.net > 0 else "gray"
        ax.plot([100 * low, 100 * high], [place, place], color=colour)
        ax.plot(100 * effect.recovered.rate, place, "o", color=colour)
        if effect.broken is not None:
            ax.plot(100 * effect.harm, place, "x", color="tab:red")
    if report.measured is not None and report.measured.repetition is not None:
        ax.axvline(100 * report.measured.repetition.rate, color="black", linestyle=":")
    names = [f"{effect.trial.hypothesis}: {effect.trial.change}" for effect, _ in report.effects]
    ax.set_yticks(range(len(names)), names, fontsize=8)
    ax.set(
        xlim=(-2, 102),
        ylim=(-0.6, len(names) - 0.4),
        xlabel="failures that succeed then [%], 95 % interval; green: beyond chance\n"
        "x: as many successes break; dotted: by repetition",
    )
    ax.invert_yaxis()
    ax.grid(alpha=0.3)
