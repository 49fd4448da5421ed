"""``act-chunking compare`` as a user meets it."""

import json

import pytest

from lerobot_act_chunking.cli.main import main


@pytest.fixture
def evaluations(tmp_path):
    """Folders as lerobot-eval fills them: one policy fails twice as often."""
    for name, failures in (("good", 30), ("poor", 60)):
        successes = [False] * failures + [True] * (200 - failures)
        (tmp_path / name).mkdir()
        content = {"per_task": [{"task_group": "a", "task_id": 0, "metrics": {"successes": successes}}]}
        (tmp_path / name / "eval_info.json").write_text(json.dumps(content))
    return tmp_path


def test_files_are_made_and_the_status_is_the_verdict(evaluations, capsys):
    where = ["--json", str(evaluations / "c.json"), "--out", str(evaluations / "c.png")]
    assert main(["compare", str(evaluations / "poor"), f"best={evaluations / 'good'}", *where]) == 0
    printed = capsys.readouterr().out
    assert "best succeeds more often than poor: by 15.0 points" in " ".join(printed.split())
    assert json.loads((evaluations / "c.json").read_text())["verdict"] == "pass"
    assert (evaluations / "c.png").exists()


def test_other_episodes_are_compared_as_such(evaluations, capsys):
    assert main(["compare", str(evaluations / "poor"), str(evaluations / "good"), "--unpaired"]) == 0
    printed = capsys.readouterr().out
    assert "good - poor" in printed
    assert "e-value" not in printed


def test_what_cannot_be_compared_is_refused(evaluations, capsys):
    assert main(["compare", str(evaluations / "poor"), str(evaluations / "absent")]) == 1
    assert "no evaluation at" in capsys.readouterr().err
    (evaluations / "file").touch()
    assert main(["compare", str(evaluations / "poor"), str(evaluations / "file")]) == 1
    assert "no evaluation at" in capsys.readouterr().err
    assert main(["compare"]) == 2
