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
    """Print a line of values and a paragraph for each setting, which can be read at any width."""
    from rich.padding import Padding
    from rich.text import Text

    console = Console()
    for group, members in groupby(settings, key=lambda setting: setting.group):
        console.print(Text(f"Settings of {group}", style="bold underline"))
        for row in members:
            console.print(Text.assemble("\n", (row.name, "bold cyan"), f" = {_values(row)}"))
            what = Text.assemble(row.meaning.replace("`", ""), (f" Allowed: {row.allowed}.", "dim"))
            console.print(Padding(what, (0, 0, 0, 4)))
        console.print()


def _values(setting: "Setting") -> str:
    """The value in the first preset, and in the others where it differs: ``100 (paper: 64)``."""
    (_, first), *others = setting.values.items()
    different = [f"{preset}: {value}" for preset, value in others if value != first]
    return first + (f" ({', '.join(different)})" if different else "")
