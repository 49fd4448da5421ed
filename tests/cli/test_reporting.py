"""How the commands of all instruments end, and how they read lists of numbers."""

import pytest
import typer

from lerobot_act_chunking.cli.options import parse_numbers, whole_numbers
from lerobot_act_chunking.cli.reporting import finish
from lerobot_act_chunking.diagnostics.core.report import Judgement, Report
from lerobot_act_chunking.errors import ConfigurationError


class Bad(Report):
    tool = "eyes"

    def content(self):
        return {"verdict": self.verdict}


BAD = Bad(judgement=Judgement("fail", ["it looks bad"]))


def draw(_report, path):
    path.write_bytes(b"picture")
    return path


def test_files_printed_lines_and_status(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    files = {"json": tmp_path / "a.json", "picture": tmp_path / "a.png"}
    with pytest.raises(typer.Exit) as end:
        finish(BAD, lambda report, console: console.print("shown"), draw, made=["checkpoint: x"], **files)
    assert end.value.exit_code == 11
    lines = [f"numbers: {files['json']}", f"picture: {files['picture']}"]
    assert capsys.readouterr().out.splitlines() == ["shown", "checkpoint: x", *lines]
    assert '"verdict": "fail"' in files["json"].read_text()


def test_the_files_are_there_even_if_nobody_reads_the_output(tmp_path):
    def closed(_report, _console):
        raise BrokenPipeError

    with pytest.raises(BrokenPipeError):
        finish(BAD, closed, draw, json=tmp_path / "a.json", picture=tmp_path / "a.png")
    assert {path.name for path in tmp_path.iterdir()} == {"a.json", "a.png"}


def test_without_files_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(typer.Exit):
        finish(BAD, lambda report, console: None, draw, json=None, picture=None)
    assert not any(tmp_path.iterdir())


def test_numbers_with_commas_between_them():
    assert parse_numbers("strides", "2,5, 10") == (2, 5, 10)
    assert parse_numbers("strides", None) == ()
    with pytest.raises(
        ConfigurationError, match="strides='2;5' must be numbers with commas between them: 2,5,10"
    ):
        parse_numbers("strides", "2;5")
    with pytest.raises(
        ConfigurationError, match="levels='8,' must be numbers with commas between them: 8,5,5"
    ):
        parse_numbers("levels", "8,", "8,5,5")


def test_gaps_between_commas_where_they_are_allowed():
    assert whole_numbers(" ,6,,13", KeyError(), gaps=True) == (6, 13)
    assert whole_numbers("", KeyError(), gaps=True) == ()
    with pytest.raises(KeyError):
        whole_numbers("6,hand", KeyError(), gaps=True)
