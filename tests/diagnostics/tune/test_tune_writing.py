"""``--write`` changes what was chosen in the configuration, and nothing else."""

import json
import os

import pytest
from small_policies import make_policy, save

from lerobot_act_chunking.diagnostics.tune import writing
from lerobot_act_chunking.diagnostics.tune.subject import read_subject
from lerobot_act_chunking.diagnostics.tune.writing import changes, check_writable, write
from lerobot_act_chunking.errors import ConfigurationError


def config_of(path):
    return json.loads((path / "config.json").read_text())


@pytest.fixture
def checkpoint(tmp_path):
    save(make_policy(execution="ensemble", replan_interval=1, ensemble_weighting="uniform"), tmp_path)
    return tmp_path


def chosen_of(subject, name):
    (chosen,) = [each for each in subject.candidates if str(each) == name]
    return chosen


def test_exactly_the_chosen_fields_change(checkpoint):
    subject, before = read_subject(str(checkpoint)), config_of(checkpoint)
    files = {each.name: each.read_bytes() for each in checkpoint.iterdir() if each.name != "config.json"}
    chosen = chosen_of(subject, "crossfade R=2 n=8")
    made = changes(subject, chosen)
    write(str(checkpoint), made)
    expected = {"execution": "crossfade", "replan_interval": 2, "ensemble_weighting": None}
    assert config_of(checkpoint) == {**before, **expected}
    assert list(config_of(checkpoint)) == list(before)
    assert {name: (checkpoint / name).read_bytes() for name in files} == files
    assert {*map(str, made)} == {
        'execution: "ensemble" -> "crossfade"',
        "replan_interval: 1 -> 2",
        'ensemble_weighting: "uniform" -> null',
    }
    assert {each.flag for each in made} == {
        "--policy.execution=crossfade",
        "--policy.replan_interval=2",
        "--policy.ensemble_weighting=null",
    }
    assert read_subject(str(checkpoint)).present.settings == chosen.settings


def test_the_present_settings_change_nothing(checkpoint):
    subject = read_subject(str(checkpoint))
    assert changes(subject, subject.present) == []


def test_intervals_in_seconds_give_way(tmp_path):
    save(make_policy(execution="receding", replan_s=0.1, fps=20), tmp_path)
    subject = read_subject(str(tmp_path))
    assert subject.present.settings.replan_interval == 2
    chosen = chosen_of(subject, "receding R=4 n=8")
    write(str(tmp_path), changes(subject, chosen))
    assert (config_of(tmp_path)["replan_s"], config_of(tmp_path)["replan_interval"]) == (None, 4)
    assert read_subject(str(tmp_path)).present.settings == chosen.settings


def test_lerobots_policies_are_refused_with_the_way_out(tmp_path):
    save(make_policy("act", n_action_steps=5, dropout=0.0), tmp_path)
    with pytest.raises(ConfigurationError, match=r"has no settings of chunk execution.*act-chunking wrap"):
        check_writable(read_subject(str(tmp_path)))


def test_what_may_not_be_written_to_is_refused(checkpoint, monkeypatch):
    subject = read_subject(str(checkpoint))
    check_writable(subject)
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(ConfigurationError, match=r"may not be written to: copy the checkpoint"):
        check_writable(subject)


def test_a_full_disk_leaves_the_configuration(checkpoint, monkeypatch):
    def full(path, content):
        raise OSError(28, "No space left on device")

    subject, before = read_subject(str(checkpoint)), (checkpoint / "config.json").read_bytes()
    monkeypatch.setattr(writing, "write_atomically", full)
    with pytest.raises(ConfigurationError, match=r"could not be written, and is as it was"):
        write(str(checkpoint), changes(subject, subject.candidates[-1]))
    assert (checkpoint / "config.json").read_bytes() == before
