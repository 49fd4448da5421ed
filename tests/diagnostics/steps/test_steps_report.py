"""The report, its JSON, card and picture."""

import json
from dataclasses import replace

import numpy as np
import pytest
from fields import MEASURE, gaussian, grid_of, three_modes
from rich.console import Console

from lerobot_act_chunking.diagnostics.core.measures import AlohaGraspPoints
from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate
from lerobot_act_chunking.diagnostics.steps import notes
from lerobot_act_chunking.diagnostics.steps.grid import Cell
from lerobot_act_chunking.diagnostics.steps.measuring import Scale, run_sweep
from lerobot_act_chunking.diagnostics.steps.plots import plot_report
from lerobot_act_chunking.diagnostics.steps.report import StepsReport
from lerobot_act_chunking.diagnostics.steps.settings import Settings, tolerance_of
from lerobot_act_chunking.diagnostics.steps.sources import HeldOut
from lerobot_act_chunking.diagnostics.steps.success import SuccessOfCell, cells_to_run
from lerobot_act_chunking.diagnostics.steps.terminal import print_report
from lerobot_act_chunking.diagnostics.steps.verdict import judge
from lerobot_act_chunking.errors import ConfigurationError

PNG = b"\x89PNG\r\n\x1a\n"
SETTINGS = {"type": "diffusion_chunked", "objective": "flow", "executed_steps": 5}


def report_of(subject, grid, tolerance=0.3, *, seen=False, configured=None):
    demonstrated = subject.demonstrated()
    sweep = run_sweep(
        subject, grid, demonstrated, MEASURE, Scale(distributions=8, noises=12, tolerance=tolerance)
    )
    judgement = judge(sweep, grid.own, tolerance, MEASURE.unit)
    held_out = HeldOut("demos", 50.0, [7, 8, 9], seen, {}, demonstrated, MEASURE)
    told = notes.notes_on(sweep, judgement, held_out, configured or grid.own, grid.own)
    return StepsReport(
        requested=Settings("checkpoint"),
        settings=SETTINGS,
        own=grid.own,
        held_out=held_out,
        tolerance=tolerance,
        sweep=sweep,
        judgement=judgement,
        notes=told,
    )


@pytest.fixture(scope="module")
def precise():
    return report_of(gaussian(0.1), grid_of(Cell("midpoint", 10)), 0.3)


@pytest.fixture(scope="module")
def limited():
    return report_of(gaussian(0.5), grid_of(), 0.02, seen=True)


@pytest.fixture(scope="module")
def forked():
    return report_of(three_modes(masses=(0.7, 0.3)), grid_of(Cell("euler", 3), samplers=["euler"]), 0.3)


def card_of(report):
    console = Console(width=200)
    with console.capture() as capture:
        print_report(report, console)
    return " ".join(capture.get().split())


def test_json_holds_every_cell(precise):
    content = json.loads(json.dumps(precise.to_json(), allow_nan=False))
    assert content["tool"] == "steps"
    assert content["verdict"] == "pass"
    assert content["policy_type"] == "diffusion_chunked"
    assert content["own"] == {"sampler": "midpoint", "n_steps": 10, "spacing": None}
    assert content["thresholds"]["tolerance"] == 0.3
    assert content["thresholds"]["model_limited_from"] == 0.6
    assert len(content["cells"]) == len(precise.sweep.cells)
    cell = next(c for c in content["cells"] if (c["sampler"], c["n_steps"]) == ("heun", 5))
    assert cell["error"]["p95"] > cell["error"]["p50"] > 0
    assert cell["evaluations"] == 9
    assert cell["ms"] == 20
    assert content["reference"]["cell"]["n_steps"] == 100
    assert content["recommended"]["flags"].startswith("--policy.sampler=")
    assert {each["sampler"] for each in content["series"]} == {"euler", "midpoint", "heun", "rk4"}
    assert content["success"] is None
    assert precise.exit_code == 0


def test_a_limited_model_is_told_what_helps(limited):
    assert limited.exit_code == 11
    content = limited.to_json()
    assert content["limit"] == "spread"
    assert notes.TOO_WIDE in content["notes"]
    assert notes.SEEN in content["notes"]
    card = card_of(limited)
    assert "fail: model-limited" in card
    assert "as near to the demonstrations as any" in card
    assert "What helps a model that spreads" in card


def test_card_of_a_precise_model(precise):
    card = card_of(precise)
    for text in (
        "midpoint 10 of diffusion_chunked",
        "of the chunks against midpoint 100, in raw units",
        "256 from episodes 7 to 9, 128 near contact; 5 control steps each",
        "modes one for each observation",
        "recommended --policy.sampler=",
        "pass: midpoint 10 is within",
        "plateau [steps] euler",
    ):
        assert text in card
    assert "flattering" not in card


def test_the_dimensions_that_decide_are_named_in_raw_units(precise):
    worst = precise.sweep.of(precise.own).error_by_point
    assert f"farthest off {max(worst, key=worst.get)} " in card_of(precise)


def told_about(report, **changes):
    sweep = replace(report.sweep, **changes)
    return notes.notes_on(sweep, report.judgement, report.held_out, report.own, report.own)


def test_few_observations_near_contact_are_told(precise):
    few = "Only 10 of the observations are near contact: what is said of contact rests on these."
    assert few in told_about(precise, n_near_contact=10)
    assert not any("near contact:" in note for note in precise.notes)


def test_more_calls_for_nothing_are_told(precise):
    """On a real recording, 79 calls were advised where the policy's 5 were nearer to the demonstrations."""
    own = Cell("euler", 1)
    slow = replace(precise, own=own)
    best = precise.judgement.recommended.cell
    far, near = precise.sweep.of(best), replace(precise.sweep.of(own), demonstration_error=0.0)
    cells = [near if result.cell == own else result for result in precise.sweep.cells]
    (told,) = (note for note in told_about(slow, cells=cells) if "comes no nearer" in note)
    assert told.startswith(f"{best} follows the model more exactly")
    assert f"they are {far.demonstration_error:.3g} raw units away, now 0." in told
    cells = [replace(near, demonstration_error=1e3) if r.cell == own else r for r in cells]
    assert not any("comes no nearer" in note for note in told_about(slow, cells=cells))
    assert not any("comes no nearer" in note for note in precise.notes)


def test_modes_are_reported(forked):
    card = card_of(forked)
    assert " with 2; " in card
    assert "of the observations have several modes" in card
    assert "flipped" in card


def test_the_sampler_that_stands_in_is_named():
    configured = Cell("ddpm", 100)
    notes = report_of(gaussian(0.1), grid_of(steps=[2], samplers=["euler"]), 0.3, configured=configured).notes
    assert any("samples with ddpm, which draws noise at every step" in note for note in notes)


@pytest.mark.parametrize("name", ["precise", "limited", "forked"])
def test_picture(name, request, tmp_path):
    path = plot_report(request.getfixturevalue(name), tmp_path / "new" / "steps.png")
    assert path.read_bytes().startswith(PNG)


def test_tolerance_is_half_a_millimetre_only_where_there_are_millimetres():
    assert tolerance_of(None, AlohaGraspPoints()) == 0.5
    assert tolerance_of(0.02, MEASURE) == 0.02
    with pytest.raises(ConfigurationError, match="say with --tolerance how much of a difference in raw"):
        tolerance_of(None, MEASURE)


def test_success_is_run_where_steps_may_matter(precise):
    cells = [result.cell for result in precise.sweep.cells]
    assert [cell.n_steps for cell in cells_to_run(precise.own, cells)] == [1, 2, 3, 5, 8, 10, 16, 20]
    assert all(cell.sampler == "midpoint" for cell in cells_to_run(precise.own, cells))
    found = SuccessOfCell(Cell("euler", 3), SuccessRate(9, 10)).to_json()
    assert (found["n_steps"], found["successes"], found["episodes"]) == (3, 9, 10)
    assert np.allclose(found["interval"], SuccessRate(9, 10).interval)
