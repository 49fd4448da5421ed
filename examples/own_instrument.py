"""An instrument of your own: how long do demonstrations wait, with no command changing?"""

import sys
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
import typer
from rich.console import Console

from act_chunking_runtime.number_checks import check_positive
from lerobot_act_chunking.cli.options import Json
from lerobot_act_chunking.cli.reporting import finish
from lerobot_act_chunking.cli.running import run
from lerobot_act_chunking.diagnostics.core.episodes import read_episodes
from lerobot_act_chunking.diagnostics.core.report import Judgement, Report
from lerobot_act_chunking.diagnostics.core.terminal import print_verdict


@dataclass(frozen=True)
class Settings:
    dataset: str
    most_s: float = 1.0

    def __post_init__(self) -> None:
        check_positive(most_s=self.most_s)


@dataclass(frozen=True, kw_only=True)
class WaitingReport(Report):
    tool: ClassVar[str] = "waiting"
    longest_s: float

    def content(self) -> dict[str, Any]:
        return {"verdict": self.verdict, "reasons": self.reasons, "longest_s": self.longest_s}


def diagnose(settings: Settings) -> WaitingReport:
    found = read_episodes(settings.dataset)
    moves = [np.any(np.diff(rows, axis=0) != 0, axis=1) for rows in found.episodes.values()]
    ends = [np.flatnonzero(np.r_[True, row, True]) for row in moves]
    longest_s = float(max(np.diff(row).max() - 1 for row in ends) / found.fps)
    verdict = "pass" if longest_s <= settings.most_s else "warn"
    reasons = [f"the longest wait takes {longest_s:.2g} s, allowed {settings.most_s:g} s"]
    return WaitingReport(judgement=Judgement(verdict, reasons), longest_s=longest_s)


def print_report(report: WaitingReport, console: Console) -> None:
    print_verdict(report, console)


def waiting_command(dataset: str, most_s: Annotated[float, typer.Option()] = 1.0, json: Json = None) -> None:
    """How long do demonstrations wait?"""
    finish(diagnose(Settings(dataset, most_s)), print_report, json=json)


if __name__ == "__main__":
    app = typer.Typer()
    app.command()(waiting_command)
    sys.exit(run(app))
