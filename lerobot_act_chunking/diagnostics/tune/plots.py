"""The diagnosis as a picture."""

from pathlib import Path
from typing import Any

from lerobot_act_chunking.diagnostics.tune.candidates import Candidate
from lerobot_act_chunking.diagnostics.tune.racing import Race
from lerobot_act_chunking.diagnostics.tune.report import TuneReport


def plot_report(report: TuneReport, path: Path) -> Path:
    """What every candidate reached, into a PNG; returns its path."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 1.5 + 0.25 * len(report.candidates)), layout="constrained")
    ax = figure.subplots()
    if report.race:
        _draw_race(ax, report, report.race)
    else:
        _draw_replays(ax, report)
    ax.set_title(f"{report.verdict}: {report.judgement.chosen}\non {report.where}", fontsize=10)
    ax.invert_yaxis()
    ax.grid(alpha=0.3)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    return path


def _draw_race(ax: Any, report: TuneReport, race: Race[Candidate]) -> None:
    """Success rates with their intervals; candidates that were given up are grey."""
    tried = [each for each in report.candidates if race.results[each]]
    tried.sort(key=lambda each: -race.rate(each).rate)
    for place, candidate in enumerate(tried):
        rate = race.rate(candidate)
        low, high = rate.interval
        colour = "gray" if candidate in race.dropped else _colour(report, candidate)
        ax.plot([100 * low, 100 * high], [place, place], color=colour)
        ax.plot(100 * rate.rate, place, "o", color=colour)
    names = [f"{each}, {race.rate(each).episodes} episodes" for each in tried]
    ax.set_yticks(range(len(tried)), names, fontsize=8)
    ax.set(xlim=(0, 100), xlabel="success [%], 95 % interval; green: chosen, gray: given up")


def _draw_replays(ax: Any, report: TuneReport) -> None:
    found = report.replays or {}
    tried = sorted(found, key=lambda each: found[each].distance)
    colours = [_colour(report, each) for each in tried]
    ax.barh(range(len(tried)), [found[each].distance for each in tried], color=colours)
    ax.set_yticks(range(len(tried)), map(str, tried), fontsize=8)
    ax.set(xlabel="distance to the demonstrations [standard deviations]; green: chosen")


def _colour(report: TuneReport, candidate: Candidate) -> str:
    return "tab:green" if candidate == report.judgement.chosen else "tab:blue"
