"""The tables of docs/studies/demonstrators.md, from the committed results.

    python benchmarks/operator_table.py

reads benchmarks/results/operators.json, operators_fetch.json, smoothed.json and pushed.json and writes the
tables between their marks; a test compares.
"""

import argparse
import json
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"
PAGE = ROOT / "docs" / "studies" / "demonstrators.md"
COLUMNS = ("default", "crossfade 25 over 10", "ensemble 25", "open loop")
DEMONSTRATIONS = 50  # of one person
EVERYBODY, EVERYBODY_COLUMNS = "everybody", ("default", "ensemble 25", "open loop")
DEFAULTS = ("as it comes", "crossfade 25 over 50")
"""Executions that are the default: the second one of chunks of 100 steps."""

NAMES = {
    "act_chunked_history_1500": "`act_chunked`, every step, two observations",
    "act_small_4000": "`act_chunked`, every step, the quickstart's sizes",
    "act_small_spaced_4000": "`act_chunked`, the quickstart's sizes",
    "act_one_action_1500": "`act_chunked`, one action a query",
    "act_faster_1500": "`act_chunked`, rate 1e-3",
    "vqbet_faster_1500": "`vqbet_chunked`, rate 1e-3",
    "diffusion_faster_1500": "`diffusion_chunked`, rate 2e-3",
    **{
        f"diffusion_slower{name}_{steps}": f"`diffusion_chunked`{told}, rate 5e-4"
        for name, told in (("", ""), ("_every_step", ", every step"))
        for steps in (1500, 4000)
    },
    "diffusion_slower_128_2000": "`diffusion_chunked`, 128 wide, rate 5e-4",
    "diffusion_recipe": "`diffusion_chunked`, configs/diffusion.yaml",
    "vqbet_recipe": "`vqbet_chunked`, configs/vqbet.yaml",
    "act_vae_1500": "`act_chunked`, a sampled style",
    "act_12x2_1500": "`act_chunked`, every second step",
    "vqbet_50_1500": "`vqbet_chunked`, every step, for one second",
}

LEROBOT_COLUMNS = (
    "as it comes",
    "ensemble 25",
    "open loop, mean of 5",
    "crossfade 25 over 50",
    "crossfade 25 over 50, mean of 5",
)

FETCH_COLUMNS = (
    *(f"receding {interval}" for interval in (2, 4, 5, 6, 10, 12)),
    "open loop",
    "crossfade 6 over 12",
    "ensemble 6",
)


def shown(successes: int, episodes: int) -> str:
    return f"{successes} ({SuccessRate(successes, episodes).percent})"


def by_operator() -> Iterator[str]:
    """What policies of this package learn from one person each."""
    entries = [
        each
        for each in read("operators")
        if each["operator"] != EVERYBODY
        and each["demonstrations"] == DEMONSTRATIONS
        and not each["run"]["variant"].startswith("lerobot")
    ]
    yield from table(
        ("task", "person", "policy", "training steps", "training seed"),
        COLUMNS,
        default_named(entries),
        lambda entry: (entry["run"]["task"], f"`{entry['operator']}`", *training_of(entry)),
    )


def of_everybody() -> Iterator[str]:
    """What policies learn from all people in one dataset."""
    entries = [
        each
        for each in read("operators")
        if each["operator"] == EVERYBODY and not each["run"]["variant"].startswith("lerobot")
    ]
    yield from table(
        ("task", "demonstrations", "policy", "training steps", "training seed", "CPU minutes"),
        EVERYBODY_COLUMNS,
        default_named(entries),
        lambda entry: (
            entry["run"]["task"],
            entry["demonstrations"],
            *training_of(entry),
            f"{entry['train']['cpu_minutes']:.1f}",
        ),
    )


def default_named(entries: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """The same evaluations, those of our default execution under that name."""
    return [{**each, "execution": "default"} if each["execution"] in DEFAULTS else each for each in entries]


def read(name: str) -> list[dict[str, Any]]:
    return json.loads((RESULTS / f"{name}.json").read_text())


def training_of(entry: dict[str, Any]) -> tuple[str, int, int]:
    """The policy, how many steps it was trained for, and the training seed."""
    return policy_of(entry), entry["train"]["steps"], entry["run"]["seed"]


def policy_of(entry: dict[str, Any]) -> str:
    variant = entry["run"]["variant"]
    if variant.startswith("lerobot_act_"):
        return f"LeRobot's `act`, rate {variant.removeprefix('lerobot_act_')}"
    kind, every_step, _ = variant.rpartition("_")[0].partition("_every_step")
    return NAMES.get(variant) or f"`{kind}`" + (", every step" if every_step else "")


def table(
    headings: Sequence[str],
    columns: Sequence[str],
    entries: Iterable[dict[str, Any]],
    row_of: Callable[[dict[str, Any]], tuple[Any, ...]],
) -> Iterator[str]:
    """Successes, a row for each training and a column for each execution.

    Args:
        headings: of what describes a training.
        columns: executions.
        entries: evaluations.
        row_of: what describes the training of an evaluation.
    """
    rows: dict[tuple[Any, ...], dict[str, Any]] = {}
    for entry in entries:
        row = rows.setdefault(row_of(entry), {})
        row[entry["execution"]] = entry
    yield f"| {' | '.join([*headings, *columns])} |"
    yield "|" + "---|" * len([*headings, *columns])
    for description, row in sorted(rows.items()):
        values = [successes(row.get(name)) for name in columns]
        yield f"| {' | '.join([*map(str, description), *values])} |"


def successes(entry: dict[str, Any] | None) -> str:
    if entry is None:
        return "-"
    return shown(entry["episodes"] - len(entry["failed_seeds"]), entry["episodes"])


def by_spacing() -> Iterator[str]:
    """Insertions with a prediction for every step and for every tenth of a second, acting by default."""
    rows: dict[tuple[Any, ...], dict[bool, str]] = {}
    for entry in read("operators"):
        run = entry["run"]
        name, _, steps = run["variant"].rpartition("_")
        kind, every_step, _ = name.partition("_every_step")
        of = run["task"], entry["demonstrations"]
        if entry["execution"] in DEFAULTS and of == ("insertion", DEMONSTRATIONS):
            kind = NAMES.get(f"{kind}_{steps}", f"`{kind}`")
            row = f"`{entry['operator']}`", kind, f"{steps} steps, seed {run['seed']}"
            rows.setdefault(row, {})[bool(every_step)] = successes(entry)
    yield "| person | policy | training | every step | every tenth of a second |"
    yield "|" + "---|" * 5
    for row, both in sorted(rows.items()):
        if len(both) == 2:
            yield f"| {' | '.join(row)} | {both[True]} | {both[False]} |"


def by_rate() -> Iterator[str]:
    """Insertions by the learning rate, 1500 steps, acting by default."""
    rates = {
        "act_chunked_1500": ("act_chunked", "5e-4"),
        "act_faster_1500": ("act_chunked", "1e-3"),
        "diffusion_slower_1500": ("diffusion_chunked", "5e-4"),
        "diffusion_chunked_1500": ("diffusion_chunked", "1e-3"),
        "diffusion_faster_1500": ("diffusion_chunked", "2e-3"),
        "vqbet_chunked_1500": ("vqbet_chunked", "5e-4"),
        "vqbet_faster_1500": ("vqbet_chunked", "1e-3"),
    }
    rows: dict[tuple[Any, ...], dict[str, str]] = {}
    for entry in read("operators"):
        run = entry["run"]
        of = run["task"], entry["demonstrations"], entry["execution"]
        if of == ("insertion", DEMONSTRATIONS, "as it comes") and run["variant"] in rates:
            kind, rate = rates[run["variant"]]
            row = f"`{entry['operator']}`", f"`{kind}`", run["seed"]
            rows.setdefault(row, {})[rate] = successes(entry)
    columns = ("5e-4", "1e-3", "2e-3")
    yield "| person | policy | training seed | " + " | ".join(columns) + " |"
    yield "|" + "---|" * 6
    for row, found in sorted(rows.items()):
        if len(found) > 1:
            cells = [found.get(rate, "-") for rate in columns]
            yield f"| {' | '.join(map(str, row))} | {' | '.join(cells)} |"


def left_out() -> Iterator[str]:
    """Each person with the spacing that does best on all others, and with the one that does best on it."""
    spacings = {"act_chunked_every_step_1500": "every step", "act_chunked_1500": "every tenth of a second"}
    found: dict[str, dict[str, int]] = {}
    for entry in read("operators"):
        run = entry["run"]
        of = entry["demonstrations"], entry["episodes"], run["task"], run["seed"]
        known = entry["execution"] in DEFAULTS and entry["operator"] != EVERYBODY
        if known and of == (DEMONSTRATIONS, 200, "insertion", 0) and run["variant"] in spacings:
            count = entry["episodes"] - len(entry["failed_seeds"])
            found.setdefault(entry["operator"], {})[spacings[run["variant"]]] = count
    people = {name: both for name, both in sorted(found.items()) if len(both) == len(spacings)}
    yield "| person | chosen on all others | successes with it | with the person's own best | points lost |"
    yield "|" + "---|" * 5
    for name, both in people.items():
        others = [each for other, each in people.items() if other != name]
        chosen = max(spacings.values(), key=lambda spacing: sum(each[spacing] for each in others))
        best = max(both.values())
        yield f"| `{name}` | {chosen} | {both[chosen]} | {best} | {(best - both[chosen]) / 2:.1f} |"


def of_lerobot() -> Iterator[str]:
    """LeRobot's `act` and ours, learned from the same insertions."""
    entries = [
        each
        for each in read("operators")
        if each["run"]["task"] == "insertion" and each["demonstrations"] == DEMONSTRATIONS
    ]
    people = {each["operator"] for each in entries if each["run"]["variant"].startswith("lerobot")}
    compared = ("lerobot", "act_chunked_1500", "act_chunked_4000")
    yield from table(
        ("person", "policy", "training steps", "training seed", "CPU minutes"),
        LEROBOT_COLUMNS,
        [
            each
            for each in entries
            if each["operator"] in people and each["run"]["variant"].startswith(compared)
        ],
        lambda entry: (
            f"`{entry['operator']}`",
            *training_of(entry),
            f"{entry['train']['cpu_minutes']:.1f}",
        ),
    )


def by_interval() -> Iterator[str]:
    found = {}
    for entry in read("operators"):
        match = re.fullmatch(r"crossfade (\d+) over 50", entry["execution"])
        of = (entry["operator"], entry["run"]["task"], entry["run"]["variant"])
        if match and of == ("hesitant", "insertion", "act_chunked_every_step_1500"):
            found[int(match[1])] = successes(entry)
    yield f"| a new chunk every | {' | '.join(f'{interval} steps' for interval in sorted(found))} |"
    yield "|" + "---|" * (len(found) + 1)
    yield f"| successes of 200 | {' | '.join(found[interval] for interval in sorted(found))} |"


def on_fetch() -> Iterator[str]:
    entries = read("operators_fetch")
    for entry in entries:
        if entry["execution"] == "as it comes":  # a quarter of 23 control steps
            entry["execution"] = "receding 5"
    yield from table(
        ("task", "person", "policy"),
        FETCH_COLUMNS,
        entries,
        lambda entry: (entry["run"]["task"], f"`{entry['operator']}`", policy_of(entry)),
    )


def of_smoothed() -> Iterator[str]:
    """The same network with its chunks as they are, and with their moving mean."""
    found: dict[str, dict[int, str]] = {}
    for entry in read("smoothed"):
        found.setdefault(entry["name"], {})[entry["window"]] = shown(entry["successes"], entry["episodes"])
    windows = sorted({window for each in found.values() for window in each})
    yield f"| person | {' | '.join(f'mean over {w} steps' if w > 1 else 'as predicted' for w in windows)} |"
    yield "|" + "---|" * (len(windows) + 1)
    for name, successes in sorted(found.items()):
        yield f"| `{name}` | {' | '.join(successes.get(window, '-') for window in windows)} |"


def pushed() -> Iterator[str]:
    entries = read("pushed")
    yield f"| {' | '.join(entry['execution'] for entry in entries)} |"
    yield "|" + "---|" * len(entries)
    yield f"| {' | '.join(shown(entry['successes'], entry['episodes']) for entry in entries)} |"


STRANGER = {
    "act_one_action": "`act_chunked`, one action a query",
    "diffusion_one_action": "`diffusion_chunked`, one action a token",
    "lerobot_act_1e-3": "LeRobot's `act`, rate 1e-3",
}


def of_a_stranger() -> Iterator[str]:
    """Policies on a world and a demonstrator that are not ours."""
    yield "| policy | training steps | training seed | CPU minutes | successes |"
    yield "|" + "---|" * 5
    for entry in sorted(read("stranger"), key=lambda entry: (entry["policy"], entry["seed"])):
        name, train, of = entry["policy"], entry["train"], entry["eval"]
        told = STRANGER.get(name) or f"`{name.removesuffix('_6000')}`"
        minutes, done = f"{train['cpu_minutes']:.1f}", shown(of["successes"], of["episodes"])
        yield f"| {told} | {train['steps']} | {entry['seed']} | {minutes} | {done} |"


def with_tables(text: str) -> str:
    """The page with its tables as the results have them."""
    tables = {
        "operators": by_operator(),
        "everybody": of_everybody(),
        "spacing": by_spacing(),
        "smoothed": of_smoothed(),
        "left_out": left_out(),
        "rates": by_rate(),
        "lerobot": of_lerobot(),
        "intervals": by_interval(),
        "pushed": pushed(),
        "fetch": on_fetch(),
        "stranger": of_a_stranger(),
    }
    for name, rows in tables.items():
        mark = f"<!-- {name}: python benchmarks/operator_table.py -->"
        table = "\n".join(rows)
        text = re.sub(
            rf"({re.escape(mark)}\n).*?(<!-- end -->)", rf"\1\n{table}\n\n\2", text, flags=re.DOTALL
        )
    return text


def main() -> None:
    argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args()
    PAGE.write_text(with_tables(PAGE.read_text()))


if __name__ == "__main__":
    main()
