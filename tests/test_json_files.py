"""Damaged JSON is a ValueError, whatever the damage."""

import re
from pathlib import Path

import pytest

import lerobot_act_chunking
from lerobot_act_chunking.json_files import read_json

PACKAGE = Path(lerobot_act_chunking.__file__).parent
READS_A_FILE = re.compile(r"json\.loads?\([^\n]*(read_text|read_bytes|open)\(")


def test_a_file_is_read_in_any_locale(tmp_path):
    (tmp_path / "a.json").write_text('{"joint": "épaule"}', encoding="utf-8")
    assert read_json(tmp_path / "a.json") == {"joint": "épaule"}


@pytest.mark.parametrize(
    "content", [b"", b"{", b"\xff\xfe\x00\x80", b"[" * 100_000, b'{"a":' * 100_000, b"not json"]
)
def test_damage_is_a_value_error(content, tmp_path):
    (tmp_path / "a.json").write_bytes(content)
    with pytest.raises(ValueError):  # noqa: PT011  (each damage has its own words)
        read_json(tmp_path / "a.json")


def test_an_absent_file_is_the_readers_to_explain(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_json(tmp_path / "a.json")


def test_no_module_reads_json_in_another_way():
    others = [
        path.relative_to(PACKAGE).as_posix()
        for path in PACKAGE.rglob("*.py")
        if READS_A_FILE.search(path.read_text(encoding="utf-8"))
    ]
    # what LeRobot wrote a moment before, into a folder that nobody else has
    assert set(others) <= {"json_files.py", "recording/assembly.py"}
