"""``act-chunking export``: what it refuses before anything is loaded, and what it says."""

import sys

import pytest
import torch
from lerobot.policies.factory import make_pre_post_processors
from policy_cases import CASES, STATE, A

from lerobot_act_chunking.cli.main import main
from lerobot_act_chunking.policies.exporting import export as exporting
from lerobot_act_chunking.policies.exporting.acting import exportable

CASE = next(case for case in CASES if case.inputs == STATE)


@pytest.fixture
def checkpoint(tmp_path):
    folder, policy = tmp_path / "pretrained_model", CASE.policy()
    stats = {
        key: {"mean": torch.zeros(n), "std": torch.ones(n), "min": torch.zeros(n), "max": torch.ones(n)}
        for key, n in (("observation.state", 6), ("action", A))
    }
    for part in (policy, *make_pre_post_processors(policy.config, dataset_stats=stats)):
        part.save_pretrained(folder)
    return folder


def test_what_was_exported_is_said(checkpoint, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(exporting, "graph_of", lambda *_: b"a graph")
    out = tmp_path / "robot"
    assert main(["export", str(checkpoint), "--out", str(out), "--policy.execution=receding"]) == 0
    said = capsys.readouterr().out
    assert f"{CASE.type}, 5 actions of each chunk, execution=receding, a new chunk every 1 steps" in said
    assert "it reads: observation.state float32 (6,)" in said
    assert sorted(each.name for each in out.iterdir()) == ["policy.json", "policy.onnx"]


@pytest.mark.parametrize("opset", ["17", "24"])
def test_other_opsets_are_refused(opset, checkpoint, tmp_path, capsys):
    assert main(["export", str(checkpoint), "--out", str(tmp_path / "robot"), "--opset", opset]) == 1
    assert f"--opset={opset} is none" in capsys.readouterr().err


def test_a_folder_that_exists_is_refused(checkpoint, tmp_path, capsys):
    assert main(["export", str(checkpoint), "--out", str(tmp_path)]) == 1
    assert "exists already: choose another folder" in capsys.readouterr().err


def test_without_the_extra_the_pip_command_is_named(checkpoint, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "onnxscript", None)
    assert main(["export", str(checkpoint), "--out", str(tmp_path / "robot")]) == 1
    assert "pip install 'lerobot_policy_act_chunking[export]'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("kind", "way"),
    [("act", "act-chunking import makes an act_chunked of it"), ("temporal_ensemble", "the inner policy")],
)
def test_other_types_are_refused_with_those_that_can_be(kind, way, tmp_path, monkeypatch, capsys):
    from types import SimpleNamespace

    from lerobot_act_chunking.policies import loading

    monkeypatch.setattr(loading, "read_config", lambda *_: SimpleNamespace(type=kind))
    assert main(["export", "somebody/something", "--out", str(tmp_path / "robot")]) == 1
    said = capsys.readouterr().err
    assert way in said
    assert f"what can be: {', '.join(exportable())}" in said
