"""The diagnosis on a terminal."""

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from lerobot_act_chunking.diagnostics.core.terminal import print_verdict, table_of
from lerobot_act_chunking.diagnostics.replay.report import ReplayReport

WORDS = {"policy": "policy", "hold_still": "hold still", "nearest": "nearest"}


def print_report(report: ReplayReport, console: Console) -> None:
    """Print errors by dimension, what the policy follows, its grippers and rests, and the verdict."""
    title = f"{report.policy_type} on {report.which}"
    console.print(f"[bold]{escape(title)}[/] [dim]({escape(report.requested.dataset)})[/]", soft_wrap=True)
    seconds = len(report.horizon.median["policy"]) / report.fps
    asked = f"errors over chunks of {seconds:.3g} s, median (90 %), at {report.n_observations} observations:"
    console.print(asked, highlight=False, soft_wrap=True)
    console.print(_dimensions(report))
    for note in report.floor.notes:
        console.print(f"[dim]- {escape(note)}[/]", highlight=False)
    _print_following(report, console)
    if report.grippers:
        console.print(_grippers(report))
    if report.people:
        console.print(_people(report))
    print_verdict(report, console)


def _dimensions(report: ReplayReport) -> Table:
    """Means over the horizon of the median and of the 90 % quantile."""
    who = list(report.horizon.median)
    table = table_of("in the dataset's units", *(WORDS[name] for name in who))
    for dim in report.floor.moving:
        cells = []
        for name in who:
            median, p90 = (
                np.nanmean(each[name][:, dim]) for each in (report.horizon.median, report.horizon.p90)
            )
            cells.append(f"{median:.2g} ({p90:.2g})")
        table.add_row(escape(report.names[dim]), *cells)
    return table


def _print_following(report: ReplayReport, console: Console) -> None:
    found, rests = report.following, report.hesitations
    if found is None or rests is None:
        return
    errors = ", ".join(f"{name.replace('_', ' ')} {error:.2g}" for name, error in found.errors.items())
    lines = [f"error over whole chunks, in standard deviations: {errors}"]
    if found.against_nearest is not None:
        ratio, low, high = found.against_nearest
        lines.append(f"policy / nearest demonstration: {ratio:.2f} (95 % interval {low:.2f} to {high:.2f})")
    lines += [
        f"first half second: {found.reduction:.0%} less error than holding still, change correlates "
        f"{found.correlation:.2f} with the demonstrated one",
        f"it goes {found.departure:.0%} as far from the last action as the demonstrator, "
        f"{found.departure_state:.0%} from where holding still stays",
        f"spread of first actions: {found.variation:.0%} of the demonstrated one",
        f"stands still where the demonstrator moves: {rests.policy_rests:.1%} of the frames; the reverse: "
        f"{rests.demonstrator_rests:.1%}",
    ]
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True)


def _grippers(report: ReplayReport) -> Table:
    table = table_of("gripper", "switches", "policy later by \\[s]", "missed", "extra")
    for each in report.grippers:
        delay = f"{np.median(each.delays_s):+.2f}" if each.delays_s else "-"
        table.add_row(escape(each.name), str(each.demonstrated), delay, str(each.missed), str(each.extra))
    return table


def _people(report: ReplayReport) -> Table:
    who = list(report.horizon.median)
    table = table_of("person", "episodes", *(WORDS[name] for name in who))
    for person, found in report.people.items():
        table.add_row(escape(person), str(found["episodes"]), *(f"{found[name]:.2g}" for name in who))
    return table
