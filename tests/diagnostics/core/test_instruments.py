"""Properties of every instrument: the same files, one way in, and a report that ends like all others."""

import importlib
import json
import typing
from dataclasses import dataclass, is_dataclass, replace
from pathlib import Path

import pytest

import lerobot_act_chunking.diagnostics
from lerobot_act_chunking.diagnostics.bandwidth.diagnosis import diagnose
from lerobot_act_chunking.diagnostics.bandwidth.settings import Settings
from lerobot_act_chunking.diagnostics.core.report import EXIT_CODES, Judgement, Report

PACKAGE = lerobot_act_chunking.diagnostics.__name__
FOLDER = Path(lerobot_act_chunking.diagnostics.__path__[0])
PACKAGES = {each.parent.name for each in FOLDER.glob("*/__init__.py")} - {"core"}
MODULES = {each.stem for each in FOLDER.glob("*.py") if "(Report)" in each.read_text()}
INSTRUMENTS = sorted(PACKAGES | MODULES)


def part(instrument, name):
    """A file of an instrument, or the module that is all of it."""
    own = f"{PACKAGE}.{instrument}"
    return importlib.import_module(own if instrument in MODULES else f"{own}.{name}")


def reports_of(instrument):
    """The kinds of report that an instrument's only entry returns."""
    returned = typing.get_type_hints(part(instrument, "diagnosis").diagnose)["return"]
    return typing.get_args(returned) or (returned,)


def test_they_are_found():
    assert {"bandwidth", "data", "tune"} <= PACKAGES


@pytest.mark.parametrize("instrument", INSTRUMENTS)
def test_one_way_in_from_settings_to_a_report(instrument):
    settings = part(instrument, "settings").Settings
    asked, *others = typing.get_type_hints(part(instrument, "diagnosis").diagnose).values()
    assert is_dataclass(settings)
    assert asked is settings
    assert others
    for report in reports_of(instrument):
        assert issubclass(report, Report)
        assert report.tool.removeprefix("act-chunking ") == instrument


@pytest.mark.parametrize("instrument", INSTRUMENTS)
def test_every_report_is_measured_printed_and_drawn_by_the_same_names(instrument):
    for report in reports_of(instrument):
        beside = report.__module__.removesuffix(".report").removeprefix(f"{PACKAGE}.")
        assert callable(part(beside, "terminal").print_report)
        if beside not in MODULES:  # a module need not draw
            assert callable(part(beside, "plots").plot_report)
            assert part(beside, "measuring")


@dataclass(frozen=True, kw_only=True)
class Weight(Report):
    """An instrument of one number."""

    tool: typing.ClassVar[str] = "scales"
    grams: float

    def content(self):
        return {"verdict": self.verdict, "grams": self.grams}


def found(verdict="pass"):
    return Weight(judgement=Judgement(verdict, ["it is heavy"]), grams=1.5)


@pytest.mark.parametrize("verdict", ["pass", "warn", "fail", "inconclusive"])
def test_a_verdict_its_reasons_and_its_status(verdict):
    report = found(verdict)
    assert (report.verdict, report.reasons) == (verdict, ["it is heavy"])
    assert report.exit_code == EXIT_CODES[verdict]
    assert report.exit_code in (0, 10, 11)


def test_json_begins_with_the_tool_and_the_version(tmp_path):
    content = json.loads(found().write(tmp_path / "new" / "weight.json").read_text())
    assert list(content) == ["tool", "version", "verdict", "grams"]
    assert content["tool"] == "scales"
    assert content["version"]


def test_json_has_no_numbers_that_json_does_not_know(tmp_path):
    with pytest.raises(ValueError, match="not JSON compliant"):
        replace(found(), grams=float("nan")).write(tmp_path / "weight.json")
    assert not (tmp_path / "weight.json").exists()


def test_the_same_from_an_instrument():
    report = diagnose(Settings(execution={"chunk_size": 10}))
    content = report.to_json()
    assert list(content)[:2] == ["tool", "version"]
    assert (content["verdict"], content["reasons"]) == (report.verdict, report.reasons)
    assert report.exit_code == 0
