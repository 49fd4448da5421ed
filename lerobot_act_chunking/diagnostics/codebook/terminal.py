"""The diagnosis on a terminal."""

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from lerobot_act_chunking.diagnostics.codebook.drift import Drift
from lerobot_act_chunking.diagnostics.codebook.losses import Loss, Losses, WorstChunk
from lerobot_act_chunking.diagnostics.codebook.meaning import CodeUse
from lerobot_act_chunking.diagnostics.codebook.report import CodebookReport
from lerobot_act_chunking.diagnostics.codebook.subject import Subject
from lerobot_act_chunking.diagnostics.codebook.usage import LevelUsage, Usage
from lerobot_act_chunking.diagnostics.core.terminal import print_verdict, table_of

MOST_ROWS = 8
MOST_DEAD = 6


def print_report(report: CodebookReport, console: Console) -> None:
    """Print usage, losses, what the codes do, drift, what to know about it, and the verdict."""
    subject, fps = report.subject, report.demonstrations.fps
    origin = f"[dim]({subject.kind}, {escape(subject.source)})[/]"
    console.print(f"[bold]{describe(subject, fps)}[/] {origin}", soft_wrap=True)
    episodes = len(report.demonstrations.episodes)
    data = f"{report.usage.chunks} chunks from {episodes} episodes of {report.demonstrations.folder}"
    console.print(data, highlight=False, soft_wrap=True)
    console.print(_usage_table(report.usage))
    console.print(_losses_table(report.losses))
    if report.uses:
        console.print(_uses_table(report.uses))
    facts = Table(show_header=False, box=None, pad_edge=False)
    facts.add_column()
    facts.add_column(overflow="fold")
    for row in _rows(report):
        facts.add_row(*row)
    console.print(facts)
    for note in report.notes:
        console.print(f"[dim]- {note}[/]", highlight=False)
    print_verdict(report, console)


def describe(subject: Subject, fps: float) -> str:
    """A tokenizer in one line."""
    timing, tokenizer = subject.coder.timing, subject.coder.tokenizer
    seconds = timing.control_steps / fps
    return (
        f"{subject.settings['tokenizer']}: {tokenizer.n_codes} codes of {tokenizer.vocabulary} for "
        f"{timing.chunk_size} actions, {seconds:.2g} s"
    )


def _usage_table(usage: Usage) -> Table:
    table = table_of("level", "used", "perplexity", "dead codes")
    shown = usage.levels if len(usage.levels) <= MOST_ROWS else _extremes(usage.levels)
    for level in shown:
        table.add_row(
            str(usage.levels.index(level) + 1),
            f"{level.used} of {usage.vocabulary}",
            f"{level.perplexity:.1f}",
            _listed(level.dead),
        )
    return table


def _extremes(levels: list[LevelUsage]) -> list[LevelUsage]:
    """Of too many to list: the codes with the least, the median and the largest perplexity."""
    ordered = sorted(levels, key=lambda level: level.perplexity)
    return [ordered[0], ordered[len(ordered) // 2], ordered[-1]]


def _listed(dead: list[int]) -> str:
    if not dead:
        return "none"
    named = ", ".join(str(code) for code in dead[:MOST_DEAD])
    return named if len(dead) <= MOST_DEAD else f"{len(dead)}: {named}, ..."


def _losses_table(losses: Losses) -> Table:
    table = table_of("error of the codes alone", "mean", "95 %", "variance lost")
    for loss in losses.dimensions:
        table.add_row(loss.name, *_figures(loss, "raw"))
    for loss in losses.points:
        table.add_row(loss.name, *_figures(loss, losses.unit))
    return table


def _figures(loss: Loss, unit: str) -> tuple[str, str, str]:
    lost = "-" if loss.lost_variance is None else f"{loss.lost_variance:.1%}"
    return f"{loss.mean:.3g} {unit}", f"{loss.p95:.3g} {unit}", lost


def _uses_table(uses: list[CodeUse]) -> Table:
    table = table_of("first code", "chunks", "in the episode", "combinations")
    for use in uses[:MOST_ROWS]:
        low, _, high = use.progress
        table.add_row(str(use.code), f"{use.share:.0%}", f"{low:.0%} to {high:.0%}", str(use.combinations))
    return table


def _rows(report: CodebookReport) -> list[tuple[str, str]]:
    usage = report.usage
    rows = [
        ("combinations", _combinations(usage)),
        ("a chunk costs", f"{usage.bits:.4g} bits, {usage.entropy_bits:.4g} if frequent codes cost less"),
        ("variance lost", f"{report.losses.lost_variance:.1%}, all dimensions"),
        ("worst moments", "\n".join(_worst_chunk(chunk) for chunk in report.losses.worst)),
    ]
    return rows if report.drift is None else [*rows, ("drift", _drift(report.drift))]


def _combinations(usage: Usage) -> str:
    if usage.bits < 32:
        possible = usage.vocabulary ** len(usage.levels)
        return f"{usage.combinations} of {possible} in use ({usage.share_of_combinations:.2g})"
    return f"{usage.combinations} of 2^{usage.bits:.0f} in use"


def _worst_chunk(chunk: WorstChunk) -> str:
    return f"episode {chunk.episode} from {chunk.time_s:.1f} s: {chunk.name} off by {chunk.error:.2g}"


def _drift(drift: Drift) -> str:
    chance = "" if drift.expected is None else f" (training episodes among themselves: {drift.expected:.2f})"
    distances = ", ".join(f"{distance:.2f}" for distance in drift.distances[:MOST_ROWS])
    return (
        f"{drift.folder}, {drift.chunks} chunks\n"
        f"codes {distances} Jensen-Shannon distance by level{chance}\n"
        f"errors {drift.error_ratio:.2f} times the training's, {drift.beyond:.1%} of chunks beyond its 99 %"
    )
