"""Property: every command that a message, docstring or page names exists, with its subcommand and options."""

import ast
import itertools
import re
from dataclasses import fields
from functools import cache
from importlib import import_module
from importlib.metadata import distribution, requires
from pathlib import Path

import pytest
import typer.main
from lerobot.configs import PreTrainedConfig
from lerobot.envs.configs import EnvConfig
from lerobot.robots.config import RobotConfig
from lerobot.teleoperators.config import TeleoperatorConfig
from lerobot.utils.import_utils import register_third_party_plugins
from packaging.requirements import Requirement

from lerobot_act_chunking.cli.main import app

ROOT = Path(__file__).parents[2]
SOURCES = sorted(
    file for name in ("lerobot_act_chunking", "act_chunking_runtime") for file in (ROOT / name).rglob("*.py")
)
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
ENDS = re.compile(r"[`;|&#\n]|\s(?:and|or|with|needs|makes|shows|reads)\s|[.,:)]\s|\. |…")
OURS = re.compile(r"\bact-chunking (?!did )")
LEROBOTS = re.compile(r"\blerobot-(?!policy|env|act|teleoperator|robot)[a-z]+(?:-[a-z]+)*\b(?!/|_)")


def texts(path: Path) -> list[str]:
    """Texts of a page, or the constants of a module; a long command is on one line."""
    content = path.read_text()
    if path.suffix == ".md":
        return [re.sub(r"\\\n\s*", "", content)]
    found = []
    for node in ast.walk(ast.parse(content)):
        if isinstance(node, ast.JoinedStr):
            parts = [each.value if isinstance(each, ast.Constant) else "<value>" for each in node.values]
            found.append("".join(map(str, parts)))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found.append(node.value)
    return found


def commands(pattern: re.Pattern[str]) -> list[tuple[str, str]]:
    """(file, command up to where the sentence or the line goes on) of everything that is named."""
    return [
        (path.name, ENDS.split(text[match.start() :], maxsplit=1)[0].strip())
        for path in SOURCES + PAGES
        for text in texts(path)
        for match in pattern.finditer(text)
    ]


@cache
def options(*kinds: type) -> set[str]:
    """All fields of all registered configurations of these kinds."""
    register_third_party_plugins()
    for module in ("robots.so_follower", "teleoperators.so_leader"):
        import_module(f"lerobot.{module}")
    classes = itertools.chain(*(kind.get_known_choices().values() for kind in kinds))
    return {each.name for config_class in classes for each in fields(config_class)}


def missing(command: str) -> str | None:
    """What of an ``act-chunking`` command does not exist."""
    group = typer.main.get_command(app)
    words = command.split()[1:]
    while hasattr(group, "commands") and words and re.fullmatch(r"[a-z][a-z-]+", words[0]):
        if words[0] not in group.commands:
            return words[0]
        group, words = group.commands[words[0]], words[1:]
    known = {name for each in group.params for name in (*each.opts, *each.secondary_opts)} | {"--help"}
    asked = [word.split("=")[0] for word in words if word.startswith("--") and word != "--"]
    if "--env.FIELD" in known:  # `test_settings_exist` looks at the fields
        asked = [option for option in asked if not option.startswith("--env.")]
    for prefix in ("--robot.", "--policy."):
        if f"{prefix}FIELD" in known:
            asked = [option for option in asked if not option.startswith(prefix)]
    return next((option for option in asked if option not in known and not hasattr(group, "commands")), None)


def test_our_commands_exist():
    assert [missing(f"act-chunking {each}") for each in ("smothness X", "hub lst", "record --tasks a")] == [
        "smothness",
        "lst",
        "--tasks",
    ]
    named = commands(OURS)
    assert len(named) > 100
    assert [(file, command, gone) for file, command in named if (gone := missing(command))] == []


def test_lerobots_commands_exist():
    scripts = {each.name for each in distribution("lerobot").entry_points if each.group == "console_scripts"}
    named = commands(LEROBOTS)
    assert len(named) > 50
    assert {match for _, command in named for match in LEROBOTS.findall(command)} - {"lerobot-hub"} <= scripts


@pytest.mark.parametrize(
    ("kind", "prefix"),
    [
        (PreTrainedConfig, "policy"),
        (EnvConfig, "env"),
        (RobotConfig, "robot"),
        (TeleoperatorConfig, "teleop"),
    ],
)
def test_settings_exist(kind, prefix):
    pattern = re.compile(rf"--{prefix}\.([a-z_][a-z_0-9]*)")
    named = {
        (path.name, name)
        for path in SOURCES + PAGES
        for text in texts(path)
        for name in pattern.findall(text)
    }
    assert len(named) > (20 if prefix in ("policy", "env") else 2)
    assert {
        (file, name)
        for file, name in named
        if name not in options(kind) | {"type", "path", "discover_packages_path"}
    } == set()


def test_what_pip_is_told_to_install_is_an_extra_or_a_dependency():
    ours = "lerobot_policy_act_chunking"
    declared = {Requirement(each).name: Requirement(each).specifier for each in requires(ours) or []}
    asked = {
        match
        for path in SOURCES
        for text in texts(path)
        for match in re.findall(r"pip install '?([\w-]+)", text)
    }
    assert asked
    assert {name for name in asked if name not in declared and name != "value"} == set()
