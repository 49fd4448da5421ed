"""Verdicts of a dataset: what is advised, printed, written and drawn."""

import json

import numpy as np
import pytest
from planted_data import NAMES, held, plain, reach, recording, report_of
from rich.console import Console

from lerobot_act_chunking.diagnostics.data.cameras import Camera, CameraEpisode
from lerobot_act_chunking.diagnostics.data.measuring import sound
from lerobot_act_chunking.diagnostics.data.plots import plot_report
from lerobot_act_chunking.diagnostics.data.terminal import print_report
from lerobot_act_chunking.errors import DatasetError


def shown(report):
    console = Console(record=True, width=200)
    print_report(report, console)
    return console.export_text()


def camera(*episodes):
    return Camera(
        "observation.images.top",
        tuple(
            CameraEpisode(index, 100, blank, repeated, still, longest)
            for index, (blank, repeated, still, longest) in enumerate(episodes)
        ),
    )


def test_nothing_to_change_passes():
    report = report_of(recording(*plain(), operators={each: "ab"[each % 2] for each in range(12)}))
    assert (report.verdict, report.exit_code) == ("pass", 0), report.reasons
    assert report.reasons == ["12 episodes without anything that should change before training"]
    text = shown(report)
    assert "12 episodes of 5.6 to 5.6 s" in text
    assert "demonstrated by a (6), b (6)" in text
    assert "--dataset.episodes='[1,3,5,7,9,11]'" in text


@pytest.mark.parametrize(
    ("change", "advice"),
    [
        (lambda rows: held(rows, 0, 30), "at the start (median 1."),
        (lambda rows: held(rows, len(rows) - 1, 30), "at the end (median 1."),
        (lambda rows: held(rows, 50, 30), "--policy.horizon_s=2"),
    ],
)
def test_rests_are_warned_of(change, advice):
    report = report_of(recording([change(rows) for rows in plain()[0]]))
    assert report.verdict == "warn"
    assert any(advice in reason for reason in report.reasons)


def test_parked_dimensions_get_a_floor():
    rng = np.random.default_rng(3)
    actions = [np.column_stack([rows, 0.001 * rng.normal(size=len(rows))]) for rows in plain()[0]]
    report = report_of(recording(actions, names=(*NAMES, "parked")))
    assert any(
        "(parked)" in reason and "--policy.norm_std_floor=0.001" in reason for reason in report.reasons
    )


def test_two_ways_call_for_a_policy_that_chooses():
    rng = np.random.default_rng(4)
    actions = []
    for episode in range(16):
        rows = reach(rng)[4:-4]
        rows[:, 0] += (3 if episode % 2 else -3) * np.sin(np.pi * np.linspace(0, 1, len(rows)))
        actions.append(rows)
    report = report_of(recording(actions))
    assert any("in 2 ways (8 + 8 episodes)" in reason for reason in report.reasons)
    assert "ways to do the task: 2 (8 + 8 episodes)" in shown(report)


@pytest.mark.parametrize(
    ("looks", "verdict", "reason"),
    [
        (
            [(1.0, 0.9, 1.0, 5.0), (0, 0, 0, 0)],
            "fail",
            "shows nothing (one grey, such as black) in the episodes 0",
        ),
        ([(0, 0, 0, 0), (0, 0.3, 0.8, 3.0)], "fail", "is frozen while the robot moves in the episodes 1"),
        ([(0, 0, 1.0, 5.0)] * 2, "fail", "operation.feature_names=\"['observation.images.top']\""),
        ([(0, 0.5, 0.5, 0.05)] * 2, "warn", "some 10 pictures a second and not 20"),
        ([(0, 0.01, 0.1, 0.3)] * 2, "pass", "without anything that should change"),
    ],
)
def test_cameras_are_judged(looks, verdict, reason):
    report = report_of(recording(*plain()), cameras=[camera(*looks)])
    assert report.verdict == verdict
    assert any(reason in each for each in report.reasons)
    assert "observation.images.top" in shown(report)


def test_what_is_not_finite_fails_with_the_command_that_deletes_it():
    report = report_of(recording(*plain()), broken={4: ["action"]})
    assert report.verdict == "fail"
    assert "action is not finite in the episodes 4" in report.reasons[0]
    assert "--operation.episode_indices='[4]'" in report.reasons[0]


def test_broken_episodes_are_left_out_and_only_broken_ones_are_refused():
    actions, _ = plain(3)
    actions[1][5, 0] = np.nan
    data = recording(actions)
    assert data.episodes[1].broken == ["action", "observation.state"]
    assert [each.index for each in sound(data).episodes] == [0, 2]
    with pytest.raises(DatasetError, match="every episode of data/planted holds a NaN"):
        sound(recording(actions[1:2]))


def test_what_never_moves_fails_and_what_is_short_is_inconclusive(tmp_path):
    still = report_of(recording([np.ones((100, 3))] * 3))
    assert (still.verdict, still.exit_code) == ("fail", 11)
    assert plot_report(still, tmp_path / "still.png").stat().st_size > 1000
    short = report_of(recording([rows[40:70] for rows in plain(3)[0]]))
    assert (short.verdict, short.exit_code) == ("inconclusive", 10)
    for report in (still, short):
        assert shown(report)
        json.dumps(report.to_json(), allow_nan=False)


def test_json_and_picture_hold_everything(tmp_path):
    report = report_of(recording(*plain()), cameras=[camera((0, 0.3, 0.1, 0.1))])
    content = json.loads(report.write(tmp_path / "deep" / "data.json").read_text())
    assert content["tool"] == "data"
    assert len(content["episodes"]) == 12
    assert content["episodes"][0]["frames"] == 112
    assert content["lags"]["dimensions"]["elbow"]["seconds"] == pytest.approx(0.1, abs=0.02)
    assert content["cameras"][0]["episodes"][0]["repeated"] == 0.3
    assert [each["name"] for each in content["action"]["dimensions"]] == list(NAMES)
    assert plot_report(report, tmp_path / "deep" / "data.png").stat().st_size > 20_000


def test_the_same_data_give_the_same_answer():
    first, again = (report_of(recording(*plain())).to_json() for _ in range(2))
    assert first == again
