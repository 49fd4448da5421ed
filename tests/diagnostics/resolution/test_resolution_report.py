"""The diagnosis as a whole: verdicts, what is refused, and what is written."""

import json

import numpy as np
import pytest
from rich.console import Console

from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes
from lerobot_act_chunking.diagnostics.resolution.measuring import measure
from lerobot_act_chunking.diagnostics.resolution.plots import plot_report
from lerobot_act_chunking.diagnostics.resolution.settings import Criteria
from lerobot_act_chunking.diagnostics.resolution.terminal import print_report, share
from lerobot_act_chunking.envs.aloha.experts.kinematics import HOME_JOINTS
from lerobot_act_chunking.envs.aloha.tasks import JOINT_NAMES
from lerobot_act_chunking.errors import ConfigurationError

FPS = 50.0


def demonstrations(*hz, lengths=(200, 150), height=1.0):
    """Waves of these frequencies; 0 is held still."""
    episodes = {}
    for episode, n in enumerate(lengths):
        time = np.arange(n)[:, None] / FPS + episode
        episodes[episode] = height * np.sin(2 * np.pi * np.array(hz) * time)
    return ActionEpisodes("data/waves", FPS, [f"joint_{dim}" for dim in range(len(hz))], episodes)


def aloha():
    rest = np.array((*HOME_JOINTS, 0.5) * 2)
    rows = np.tile(rest, (300, 1))
    rows[:, 0] += 0.2 * np.sin(2 * np.pi * 0.3 * np.arange(300) / FPS)
    return ActionEpisodes("data/aloha", FPS, JOINT_NAMES, {0: rows})


def shown(report):
    console = Console(record=True, width=200)
    print_report(report, console)
    return console.export_text()


def test_slow_motion_passes_and_names_its_flags():
    report = measure(demonstrations(0.25, 0.5), Criteria(horizon_s=1.0))
    assert (report.verdict, report.exit_code) == ("pass", 0)
    stride = report.recommended.stride
    assert stride > 1
    size = -(-49 // stride) + 1
    assert report.flags == f"--policy.chunk_stride={stride} --policy.chunk_size={size}"
    assert str(report.tolerance) == "0.01 of each range"


def test_fast_motion_asks_for_every_step():
    report = measure(demonstrations(3, 0.5), Criteria(horizon_s=1.0))
    assert (report.verdict, report.recommended.stride) == ("pass", 1)


@pytest.mark.parametrize(("chunk_stride", "verdict", "code"), [(2, "pass", 0), (25, "fail", 11)])
def test_the_stride_in_mind_is_judged(chunk_stride, verdict, code):
    report = measure(demonstrations(0.25, 0.5), Criteria(horizon_s=1.0, chunk_stride=chunk_stride))
    assert (report.verdict, report.exit_code) == (verdict, code)
    assert f"chunk_stride={chunk_stride} " in report.reasons[0]
    if code:
        assert report.reasons[0].endswith(f"take chunk_stride={report.recommended.stride}")


def test_energy_beyond_nyquist_is_a_warning_that_names_the_dimension():
    """A generous tolerance lets a stride pass that cannot show the faster wave."""
    criteria = Criteria(horizon_s=1.0, strides=(10,), tolerance=5.0)
    report = measure(demonstrations(0.5, 3.2), criteria)
    assert (report.verdict, report.exit_code) == ("warn", 0)
    assert "energy lies above 2.5 Hz" in report.reasons[1]
    assert "joint_1 (" in report.reasons[1]
    assert "joint_0" not in report.reasons[1]
    held = measure(demonstrations(0.5, 3.2), Criteria(1.0, (10,), tolerance=5.0, gripper_dims=(1,)))
    assert held.verdict == "pass"
    assert "Held between predictions" in held.notes[0]
    assert "joint_1" in held.notes[0]


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (demonstrations(0.5, lengths=(100,)), "100 control steps are too few to judge by, it takes 256"),
        (demonstrations(0, 0), "no action ever changes"),
    ],
)
def test_what_cannot_be_judged(data, reason, tmp_path):
    report = measure(data, Criteria(horizon_s=1.0))
    assert (report.verdict, report.exit_code) == ("inconclusive", 10)
    assert reason in report.reasons[0]
    assert reason in shown(report)
    json.dumps(report.to_json(), allow_nan=False)
    assert plot_report(report, tmp_path / "still.png").stat().st_size > 1000


def test_aloha_is_judged_in_millimetres(tmp_path):
    report = measure(aloha(), Criteria(horizon_s=1.0))
    assert str(report.tolerance) == "0.5 mm"
    assert report.verdict == "pass"
    found = {stride.stride: stride for stride in report.strides}
    assert found[report.recommended.stride].worst <= 0.5
    assert found[20].worst > 0.5
    text = shown(report)
    assert "rms [mm]" in text
    assert "left gripper [mm]" in text
    assert "how far grippers are open" in text
    assert plot_report(report, tmp_path / "aloha.png").stat().st_size > 1000


@pytest.mark.parametrize(
    ("criteria", "message"),
    [
        (Criteria(horizon_s=0.0), "horizon_s=0.0 must be a positive number"),
        (Criteria(horizon_s=float("nan")), "horizon_s=nan must be"),
        (Criteria(tolerance=-1.0), "tolerance=-1.0 must be a positive number"),
        (Criteria(strides=(2, 0)), "strides=0 must be at least 1"),
        (Criteria(chunk_stride=-3), "chunk_stride=-3 must be at least 1"),
        (
            Criteria(gripper_dims=(1, 2)),
            r"gripper_dims=\[1, 2\]: 2 is no dimension of these actions, which have 2",
        ),
        (Criteria(horizon_s=1.0, chunk_stride=60), "longer than --horizon-s=1"),
        (Criteria(horizon_s=0.001), "is shorter than a control step"),
    ],
)
def test_what_cannot_be_answered_is_refused(criteria, message):
    with pytest.raises(ConfigurationError, match=message):
        measure(demonstrations(0.5, 1.0), criteria)


def test_the_card_shows_every_stride_and_dimension():
    report = measure(demonstrations(0.25, 0.5), Criteria(horizon_s=1.0))
    text = shown(report)
    assert "Chunks of 1 s at 50 Hz (data/waves)" in text
    assert f"{252} chunks from 2 episodes" in text
    for stride in report.strides:
        assert f"\n{stride.stride:>6}" in text
    assert "joint_0" in text
    assert "joint_1" in text
    assert f"recommended: {report.flags}" in text
    assert text.rstrip().endswith("0.01 of each range")


def test_json_holds_every_number(tmp_path):
    report = measure(demonstrations(0.25, 0), Criteria(horizon_s=1.0, strides=(5,)))
    content = json.loads(report.write(tmp_path / "deep" / "report.json").read_text())
    assert content["tool"] == "resolution"
    assert content["recommended"] == {"chunk_stride": 5, "chunk_size": 11}
    assert [each["chunk_stride"] for each in content["strides"]] == [1, 5]
    five = content["strides"][1]
    assert (five["nyquist_hz"], five["predictions_per_second"]) == (5.0, 10.0)
    assert five["dimensions"][1]["above_nyquist"] is None
    assert five["dimensions"][0]["p95"] > 0
    assert five["farthest"] is None
    assert content["question"]["strides"] == [5]


@pytest.mark.parametrize(
    ("value", "text"), [(0.0, "0"), (0.0123, "1.2%"), (2e-5, "2e-05"), (float("nan"), "-")]
)
def test_shares_are_readable(value, text):
    assert share(value) == text


def test_a_picture_of_the_smallest_stride_alone(tmp_path):
    report = measure(demonstrations(0.25, 0.5), Criteria(horizon_s=0.04))
    assert [stride.stride for stride in report.strides] == [1]
    assert plot_report(report, tmp_path / "one.png").stat().st_size > 1000
