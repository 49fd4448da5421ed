"""The diagnosis on a terminal."""

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from lerobot_act_chunking.diagnostics.core.terminal import print_verdict, table_of
from lerobot_act_chunking.diagnostics.tune.candidates import Candidate
from lerobot_act_chunking.diagnostics.tune.racing import Race
from lerobot_act_chunking.diagnostics.tune.report import TuneReport

SEEN = "The policy was trained on these episodes: all distances are flattering."


def print_report(report: TuneReport, console: Console) -> None:
    """Print every candidate, the verdict, and how to get what was chosen."""
    source = f"[dim]({report.policy_type}, {escape(report.requested.checkpoint)})[/]"
    console.print(f"[bold]Executions on {escape(report.where)}[/] {source}", soft_wrap=True)
    console.print(_race_table(report, report.race) if report.race else _replay_table(report))
    console.print(f"[dim]{_how(report)}[/]", highlight=False)
    print_verdict(report, console)
    for line in _ways(report):
        console.print(line, highlight=False, soft_wrap=True, markup=False)


def _race_table(report: TuneReport, race: Race[Candidate]) -> Table:
    table = table_of("candidate", "successes", "95 % interval", "calls/s", "")
    order = [*race.running, *sorted(race.dropped, key=lambda each: -race.rate(each).rate)]
    for candidate in order:
        rate = race.rate(candidate)
        given_up = race.dropped.get(candidate)
        state = "" if given_up is None else f"out after round {given_up}"
        counted = (f"{rate.successes}/{rate.episodes}", rate.percent)
        table.add_row(_name(report, candidate), *counted, _calls(report, candidate), state)
    return table


def _replay_table(report: TuneReport) -> Table:
    table = table_of("candidate", "distance [std]", "jump [std]", "reaction [s]", "calls/s")
    found = report.replays or {}
    for candidate in sorted(found, key=lambda each: found[each].distance):
        measured = found[candidate]
        figures = (measured.distance, measured.jump, measured.reaction_s)
        cells = ("-" if each is None else f"{each:.3g}" for each in figures)
        table.add_row(_name(report, candidate), *cells, _calls(report, candidate))
    return table


def _name(report: TuneReport, candidate: Candidate) -> str:
    name = f"[green]{candidate}[/]" if candidate == report.judgement.chosen else str(candidate)
    return f"{name} (now)" if candidate == report.candidates[0] else name


def _calls(report: TuneReport, candidate: Candidate) -> str:
    return f"{candidate.calls_per_second(report.fps):.3g}"


def _how(report: TuneReport) -> str:
    if report.race is None:
        return SEEN if report.seen_in_training else "At the observations of episodes not known from training."
    seed = report.requested.seed
    ended = "" if report.race.complete else " (time ended before all that were planned)"
    return (
        f"{report.race.n_episodes} episodes in {report.minutes:.1f} minutes{ended}, all candidates on the "
        f"same seeds from {seed} on: evaluate the choice on others, as lerobot-eval --seed=1000"
    )


def _ways(report: TuneReport) -> list[str]:
    lines = []
    if not report.changes:
        lines.append("recommended: the present settings")
    elif report.wrap is not None:
        lines.append(f"recommended: {report.wrap}")
    else:
        lines.append(f"recommended: {report.flags}")
    if report.written:
        lines += [f"written: {change}" for change in report.changes]
    if report.folder is not None:
        lines.append(f"episodes: {report.folder}")
    return lines
