"""``act-chunking settings``: every setting of a policy type, with what each preset makes of it."""

from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from lerobot_act_chunking.cli.options import OUT

if TYPE_CHECKING:
    from lerobot_act_chunking.policies.settings_reference import Setting


def settings_command(
    policy_type: Annotated[
        str, typer.Argument(help="A policy type of this package; an unknown one is answered with all.")
    ],
    preset: Annotated[
        str | None, typer.Option(help="Show this preset alone. \\[default: all that the type has]")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(*OUT, help="Write a page of Markdown instead of printing a table.")
    ] = None,
) -> None:
    """Show every setting of a policy type: what it does, what it may hold, and its value in each preset."""
    from lerobot_act_chunking.policies.settings_reference import settings_of

    settings = settings_of(policy_type, preset)
    if out is None:
        _show(settings)
        return
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(markdown(policy_type, settings, preset), encoding="utf-8")
    Console().print(f"page: {out}", soft_wrap=True)


def markdown(policy_type: str, settings: "list[Setting]", preset: str | None = None) -> str:
    """The settings as a page of Markdown, one table for each group."""
    command = f"act-chunking settings {policy_type}" + ("" if preset is None else f" --preset {preset}")
    lines = [
        f"# Settings of `{policy_type}`",
        "",
        "All settings: what each of them does, what it may hold, and its value in each preset. The same in "
        "a terminal:",
        "",
        "```bash",
        command,
        "```",
        "",
        "Set one with `--policy.<name>=<value>`. A value that is given wins over the preset. "
        "`null → 25` means: nothing is set, and the execution mode then takes 25.",
    ]
    for group, members in groupby(settings, key=lambda setting: setting.group):
        rows = list(members)
        columns = list(rows[0].values)
        lines += ["", f"## Settings of {group}", ""]
        lines.append(f"| setting | what it does | allowed | {' | '.join(columns)} |")
        lines.append("|---" * (3 + len(columns)) + "|")
        for row in rows:
            values = " | ".join(f"`{row.values[column]}`" for column in columns)
            lines.append(f"| `{row.name}` | {_cell(row.meaning)} | {_cell(row.allowed)} | {values} |")
    return "\n".join(lines) + "\n"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def _show(settings: "list[Setting]") -> None:
    from rich.markup import escape
    from rich.table import Table

    for group, members in groupby(settings, key=lambda setting: setting.group):
        rows = list(members)
        table = Table(title=f"settings of {group}", title_justify="left", show_lines=True)
        table.add_column("setting", no_wrap=True)
        for column in rows[0].values:
            table.add_column(column, overflow="fold")
        table.add_column("allowed", overflow="fold")
        table.add_column("what it does", overflow="fold", ratio=1)
        for row in rows:
            cells = [row.name, *row.values.values(), row.allowed, row.meaning.replace("`", "")]
            table.add_row(*map(escape, cells))
        Console().print(table)
