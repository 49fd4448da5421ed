"""Properties of the whole command line: one spelling for one thing, and statuses that cannot be mistaken."""

import re

import pytest
from typer.main import get_command

from lerobot_act_chunking.cli.main import EXIT_STATUS, app, main
from lerobot_act_chunking.cli.running import REFUSED, STOPPED
from lerobot_act_chunking.diagnostics.core.report import EXIT_CODES


def all_commands(group=None, path=()):
    for name, command in (group or get_command(app)).commands.items():
        if hasattr(command, "commands"):
            yield from all_commands(command, (*path, name))
        else:
            yield " ".join((*path, name)), command


COMMANDS = dict(all_commands())
USAGE = 2


@pytest.mark.parametrize("name", COMMANDS)
def test_out_and_output_are_one_option(name):
    spellings = {"--out", "--output"}
    for option in COMMANDS[name].params:
        found = spellings & {*option.opts, *option.secondary_opts}
        assert found in (set(), spellings), f"{name} {option.opts}"


@pytest.mark.parametrize("name", ["wrap", "import", "fit-prior", "train-tokenizer", "motion", "smoothness"])
def test_what_a_command_makes_is_its_out(name):
    assert any("--out" in option.opts for option in COMMANDS[name].params)


INSTRUMENTS = [name for name in COMMANDS if any("--json" in each.opts for each in COMMANDS[name].params)]


@pytest.mark.parametrize("name", INSTRUMENTS)
def test_numbers_go_to_a_file_and_not_to_one_called_dash(name, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert main([*name.split(), "--json", "-"]) == REFUSED
    assert "--json=- would mix" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", [*INSTRUMENTS, "motion"])
def test_what_cannot_be_written_is_refused_before_anything_runs(name, capsys, tmp_path):
    file = tmp_path / "file"
    file.touch()
    refused = {
        "--json": {tmp_path: "is a folder: name a file", file / "x": "cannot be made"},
        "--out": {tmp_path: "is a folder: name a file", file / "x": "cannot be made"},
        "--output-dir": {file: "is a file: name a folder", file / "x": "cannot be made"},
    }
    there = {spelling for each in COMMANDS[name].params for spelling in each.opts}
    there -= {"--out"} if name == "fit-prior" else set()  # a checkpoint
    for option in there & refused.keys():
        for path, reason in refused[option].items():
            assert main([*name.split(), f"{option}={path}"]) == REFUSED
            assert f"{option}={path} {reason}" in " ".join(capsys.readouterr().err.split())


def test_a_verdict_is_no_error_and_no_error_a_verdict():
    verdicts = {EXIT_CODES["inconclusive"], EXIT_CODES["fail"]}
    assert len(verdicts) == 2
    assert not verdicts & {0, REFUSED, USAGE, STOPPED, *range(126, 256)}  # shells: not run, killed
    assert EXIT_CODES["pass"] == EXIT_CODES["warn"] == 0


def test_the_statuses_in_every_help_are_those_of_the_code():
    told = re.findall(r"(\d+) (?:a verdict of |of |)(\w+)", EXIT_STATUS)
    assert dict(told)["10"] == "inconclusive"
    assert dict(told)["11"] == "fail"
    allowed = {"0", *(str(EXIT_CODES[verdict]) for verdict in ("inconclusive", "fail"))}
    judging = 0
    for name, command in COMMANDS.items():
        text = " ".join((command.help or "").split())
        if "exit status" in text.lower():
            judging += 1
            stated = set(re.findall(r"\b\d+\b", text.lower().split("exit status")[1]))
            assert stated <= allowed, name
            least = (
                "inconclusive" if name in ("tune", "compare", "eval") else "fail"
            )  # they choose, and fail nothing
            assert str(EXIT_CODES[least]) in stated, name
    assert judging == 16
    assert get_command(app).epilog == EXIT_STATUS
