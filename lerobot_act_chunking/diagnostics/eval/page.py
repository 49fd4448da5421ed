"""The evaluation as one page that a browser shows without a network."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_act_chunking.diagnostics.core.played import Episode
from lerobot_act_chunking.diagnostics.eval.films import choose
from lerobot_act_chunking.diagnostics.eval.report import EvalReport, RunResult
from lerobot_act_chunking.durable_files import write_atomically

PAGE = "report.html"
TEMPLATE = "page.html.jinja"
SHOWN = 4
"""Episodes of each policy whose motion is drawn."""
POINTS = 150
WIDTH, HEIGHT = 600.0, 20.0  # of a line [pixels]


@dataclass(frozen=True)
class Line:
    """One dimension of an episode's motion.

    Attributes:
        name: of the dimension.
        command: as the points of an SVG polyline.
        low: smallest command.
        high: largest command.
    """

    name: str
    command: str
    low: float
    high: float


@dataclass(frozen=True)
class Shown:
    """An episode on the page.

    Attributes:
        episode: its record.
        seconds: its length.
        lines: its motion.
        film: as a data URI; None without one.
    """

    episode: Episode
    seconds: float
    lines: list[Line]
    film: str | None


def write_page(report: EvalReport, comparison: Mapping[str, Any] | None = None) -> Path:
    """Write everything that was found as one HTML file into the evaluation's folder; returns its path.

    Args:
        report: the evaluation.
        comparison: the content of a report of ``compare``, if there are several policies.
    """
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page = environment.get_template(TEMPLATE).render(
        report=report,
        content=report.to_json(),
        comparison=comparison,
        shown={each.run.title: _shown(each) for each in report.results},
        size=(WIDTH, HEIGHT),
    )
    path = report.folder / PAGE
    write_atomically(path, page.encode())
    return path


def _shown(result: RunResult) -> list[Shown]:
    by_seed = {each.episode.seed: each.path for each in result.films}
    places = choose(result.episodes, max(SHOWN, len(result.films)))
    return [
        Shown(
            episode=(episode := result.episodes[place]),
            seconds=result.dt * episode.length,
            lines=lines_of(result.commands(place), result.action_names),
            film=_data_uri(by_seed[episode.seed]) if episode.seed in by_seed else None,
        )
        for place in places
    ]


def lines_of(commands: np.ndarray, names: Sequence[str]) -> list[Line]:
    """Each dimension of the commands (T, A) as a line over time, scaled to its own range."""
    steps = np.unique(np.linspace(0, len(commands) - 1, POINTS).round().astype(int))
    x = WIDTH * steps / max(1, len(commands) - 1)
    lines = []
    for name, values in zip(names, commands.T, strict=True):
        low, high = float(values.min()), float(values.max())
        y = HEIGHT - 1 - (HEIGHT - 2) * (values[steps] - low) / ((high - low) or 1.0)
        points = " ".join(f"{a:.0f},{b:.1f}" for a, b in zip(x, y, strict=True))
        lines.append(Line(name, points, low, high))
    return lines


def _data_uri(path: Path) -> str:
    return "data:video/mp4;base64," + base64.b64encode(path.read_bytes()).decode()
