"""The whole diagnosis of a tokenizer: numbers, card and picture."""

import io
import json
from dataclasses import replace

import numpy as np
import pytest
from codebook_fakes import Flat, episodes, subject
from rich.console import Console

from lerobot_act_chunking.diagnostics.codebook.measuring import measure
from lerobot_act_chunking.diagnostics.codebook.plots import plot_report
from lerobot_act_chunking.diagnostics.codebook.settings import Thresholds
from lerobot_act_chunking.diagnostics.codebook.terminal import print_report

LONG = (200, 150, 180)


def diagnosed(tokenizer=None, training=None, other=None):
    return measure(subject(tokenizer), training, other, Thresholds())


@pytest.fixture(scope="module")
def report():
    return diagnosed(training=episodes(LONG), other=episodes((120,), folder="other", seed=3, shift=2.0))


def card(report):
    console = Console(width=100, record=True, file=io.StringIO())
    print_report(report, console)
    return " ".join(console.export_text().split())


def test_json_holds_everything(report, tmp_path):
    path = report.write(tmp_path / "new" / "codebook.json")
    content = json.loads(path.read_text(), parse_constant=pytest.fail)
    assert content["tool"] == "codebook"
    assert content["dataset"] == "data"
    assert content["episodes"] == [0, 1, 2]
    assert (content["chunk_size"], content["chunk_stride"]) == (4, 3)
    assert content["n_chunks"] == sum(LONG) - 3 * 3
    assert [level["used"] for level in content["usage"]["levels"]] == [7, 8]
    assert sum(content["usage"]["levels"][0]["counts"]) == content["n_chunks"]
    assert [loss["name"] for loss in content["losses"]["dimensions"]] == ["reach", "gripper"]
    assert len(content["first_code"]) == 7
    assert np.shape(content["first_code"][0]["decoded"])[1:] == (4, 2)
    assert content["drift"]["folder"] == "other"
    assert content["verdict"] == report.judgement.verdict
    assert content["thresholds"]["lost_variance"] == [0.1, 0.5]
    assert content["thresholds"]["unsaid"] == 0.5
    assert "lost_dimension_variance" not in content["thresholds"]


def test_the_card_tells_it(report):
    printed = card(report)
    assert "residual_vq: 2 codes of 8 for 4 actions, 0.5 s" in printed
    assert "521 chunks from 3 episodes of data" in printed
    assert "1 7 of 8" in printed
    assert "of 64 in use" in printed
    assert "gripper" in printed
    assert "episode" in printed
    assert "Jensen-Shannon distance by level (training episodes among themselves:" in printed
    assert f"{report.judgement.verdict}: " in printed


def test_without_an_order_no_code_is_drawn(tmp_path):
    report = diagnosed(Flat(), training=episodes(LONG))
    assert report.uses == []
    assert "empty bins are no fault" in card(report)
    assert plot_report(report, tmp_path / "flat.png").read_bytes().startswith(b"\x89PNG")


def test_the_same_data_do_not_drift():
    report = diagnosed(training=episodes(LONG), other=episodes(LONG))
    assert report.drift is None
    assert any("there is no drift to measure" in note for note in report.notes)


def test_without_training_data_the_others_are_measured():
    report = diagnosed(other=episodes(LONG, folder="other"))
    assert report.drift is None
    assert report.demonstrations.folder == "other"
    assert any("not here (data): usage and errors are those of other" in note for note in report.notes)


class InSpace:
    """Two points, one for each dimension."""

    names, unit = ("left", "right"), "mm"

    def points(self, actions):
        return np.stack([actions, 2 * actions, -actions], axis=-1)


def test_pictures(report, tmp_path):
    over_time = plot_report(report, tmp_path / "new" / "time.png")
    in_space = plot_report(replace(report, measure=InSpace()), tmp_path / "space.png")
    assert over_time.read_bytes().startswith(b"\x89PNG")
    assert in_space.read_bytes() != over_time.read_bytes()


def test_one_of_the_two_data_sets_must_be_there():
    with pytest.raises(ValueError, match="neither training nor other"):
        diagnosed()
