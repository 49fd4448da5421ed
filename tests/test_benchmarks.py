"""Asking a benchmark what it does must not run it."""

import runpy
import sys
from pathlib import Path

import pytest
from gymnasium.envs import registration
from lerobot.envs.configs import EnvConfig

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
FILES = sorted(BENCHMARKS.glob("*.py"))
SCRIPTS = [file for file in FILES if "__main__" in file.read_text()]


@pytest.fixture
def run(monkeypatch, tmp_path):
    """Runs a file as `python <file> --help` would, in an empty folder, without a process of its own."""

    def run(file: Path) -> None:
        monkeypatch.setattr(sys, "argv", [str(file), "--help"])
        runpy.run_path(str(file), run_name="__main__")

    # What a file registers is forgotten with it.
    monkeypatch.setattr(EnvConfig, "_choice_registry", dict(EnvConfig._choice_registry))
    monkeypatch.setattr(registration, "registry", dict(registration.registry))
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    before = set(sys.modules)
    yield run
    for name in set(sys.modules) - before:  # "policy", "execution", ...: plain names, which others may want
        if str(getattr(sys.modules[name], "__file__", "")).startswith(str(BENCHMARKS)):
            del sys.modules[name]


# Loaded twice, as a script and for another one.
@pytest.mark.filterwarnings("ignore:.*Overriding environment vqbet_pixels:UserWarning")
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda file: file.stem)
def test_every_script_answers_help_and_does_nothing_else(script, run, capsys, tmp_path):
    with pytest.raises(SystemExit) as end:
        run(script)
    assert end.value.code == 0
    assert f"usage: {script.name}" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "module", [file for file in FILES if file not in SCRIPTS], ids=lambda file: file.stem
)
def test_what_is_no_script_does_nothing(module, run, capsys, tmp_path):
    run(module)
    assert capsys.readouterr().out == ""
    assert list(tmp_path.iterdir()) == []
