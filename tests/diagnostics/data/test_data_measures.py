"""Every measure of a dataset on a recording in which its answer is planted."""

import numpy as np
import pytest
from planted_data import FPS, NAMES, held, later, motion_of, plain, reach, recording, report_of

from lerobot_act_chunking.diagnostics.core.stillness import Stillness, find_stillness, summarise
from lerobot_act_chunking.diagnostics.data.cameras import compare
from lerobot_act_chunking.diagnostics.data.clocks import read_clocks
from lerobot_act_chunking.diagnostics.data.operators import split_by_operator
from lerobot_act_chunking.diagnostics.data.pairing import pair_dimensions
from lerobot_act_chunking.diagnostics.data.ways import count_ways


@pytest.mark.parametrize(("start", "end"), [(0, 0), (30, 0), (0, 50), (40, 20)])
def test_planted_rests_at_the_ends(start, end):
    rows = held(held(np.linspace([0.0], [1.0], 100), 0, start), 99 + start, end)
    found = find_stillness(rows, rows.std(0), FPS)
    assert found.start == pytest.approx(start, abs=2)
    assert found.end == pytest.approx(end, abs=2)
    assert found.pauses == ()


def test_a_planted_pause_is_found_and_a_short_one_is_none():
    rows = held(held(np.linspace([0.0], [1.0], 100), 30, 25), 90, 6)
    found = find_stillness(rows, rows.std(0), FPS)
    ((first, steps),) = found.pauses
    assert first == pytest.approx(30, abs=3)
    assert steps == pytest.approx(25, abs=4)


def test_shares_of_rests_are_of_all_frames():
    """Two episodes of 10 and 30 frames: an episode has a step less than frames."""
    found = [
        Stillness(np.zeros(9), np.zeros(9, bool), start=2, end=0, pauses=((4, 3),)),
        Stillness(np.zeros(29), np.zeros(29, bool), start=6, end=10, pauses=((8, 2), (12, 5))),
    ]
    rests = summarise(found, fps=10)
    assert (rests.start_share, rests.end_share, rests.pause_share) == (8 / 40, 10 / 40, 10 / 40)
    assert (rests.start_median_s, rests.start_longest_s) == (0.4, 0.6)
    assert (rests.end_median_s, rests.end_longest_s) == (0.5, 1.0)
    assert (rests.pauses_per_episode, rests.pause_longest_s) == (1.5, 0.5)


def test_parked_limbs_do_not_hide_rests():
    rng = np.random.default_rng(1)
    actions = [held(reach(rng)[4:-4], 0, 40) for _ in range(4)]
    tremor = [np.column_stack([rows, 1e-3 * rng.normal(size=len(rows))]) for rows in actions]
    motion = motion_of(recording(tremor, names=(*NAMES, "parked")))
    assert motion.behaviours[3].kind == "noise"
    assert motion.rests.start_share == pytest.approx(40 / 152, abs=0.03)
    assert motion.rests.start_median_s == pytest.approx(2.0, abs=0.15)


def test_a_planted_jump_is_named_with_its_place():
    actions, states = plain(4)
    actions[2] = actions[2].copy()
    actions[2][50:, 0] += 1.0
    report = report_of(recording(actions, states))
    assert report.findings.actions.behaviours[0].jumps == ((2, 49),)
    assert report.findings.actions.jump_frames == 1
    assert any("shoulder (1), first in episode 2 after frame 49" in reason for reason in report.reasons)


def test_constant_and_saturated_dimensions():
    actions, _ = plain(4)
    cut = [
        np.column_stack([np.minimum(rows[:, 0], 0.6), rows[:, 1:], np.full(len(rows), 7.0)])
        for rows in actions
    ]
    report = report_of(recording(cut, names=(*NAMES, "spare")))
    shoulder, elbow, gripper, spare = report.findings.actions.behaviours
    assert spare.kind == "constant"
    assert shoulder.at_an_end[0] == 0.6
    assert shoulder.at_high == pytest.approx(np.mean(np.concatenate(cut)[:, 0] == 0.6))
    assert elbow.at_an_end[1] < 0.05
    (reason,) = [each for each in report.reasons if "least or greatest" in each]
    assert "shoulder (0.6 in " in reason
    assert "gripper" not in reason
    assert gripper.at_an_end[1] > 0.3
    assert "1 of 4 dimensions never change" in report.notes[0]


def test_a_gripper_opens_and_closes():
    actions, _ = plain(5)
    for rows in actions:
        rows[:, 2] = 0.0
        rows[20:50, 2] = rows[70:90, 2] = 1.0
    assert motion_of(recording(actions)).behaviours[2].events == 4


def test_repeated_rows():
    """Commands renewed every other frame."""
    actions = [np.repeat(rows[::2], 2, axis=0) for rows in plain(4)[0]]
    report = report_of(recording(actions))
    assert report.findings.actions.repeats.share == pytest.approx(0.5, abs=0.02)
    assert report.findings.actions.repeats.in_motion == pytest.approx(0.5, abs=0.02)
    assert any("renewed some 10 times a second" in reason for reason in report.reasons)


def test_each_dimension_has_its_own_lag_without_a_cap():
    rng = np.random.default_rng(2)
    lags = (2, 9, 56)
    waves = [np.sin(0.01 * np.cumsum(np.abs(rng.normal(1, 0.5, size=(400, 3))), 0) * 20) for _ in range(4)]
    states = [later(rows, lags) for rows in waves]
    report = report_of(recording(waves, states, names=("a", "b", "c")))
    found = report.findings.tracking.joints
    for name, lag in zip("abc", lags, strict=True):
        assert FPS * found[name].seconds == pytest.approx(lag, abs=0.6)
    (reason,) = [each for each in report.reasons if "follows the command late" in each]
    assert "c 2.8 s" in reason
    assert "--policy.horizon_s=9" in reason


def test_actions_that_are_later_states_have_no_lag():
    actions, _ = plain(4)
    report = report_of(recording([rows[1:] for rows in actions], [rows[:-1] for rows in actions]))
    assert set(report.findings.tracking.joints.values()) == {None}
    assert any("nobody commanded anything" in reason for reason in report.reasons)


def test_displacements_are_told_from_positions():
    positions, states = plain(4)
    steps = [np.diff(rows, axis=0) for rows in states]
    told = report_of(recording(steps, [rows[:-1] for rows in states]))
    assert told.findings.changes
    assert told.content()["actions_are_changes"] is True
    assert sum("changes of the state" in note for note in told.notes) == 1
    plainly = report_of(recording(positions, states))
    assert not plainly.findings.changes
    assert not any("changes of the state" in note for note in plainly.notes)


def test_states_are_paired_with_actions_by_how_they_move():
    actions, states = (np.concatenate(rows) for rows in plain(4))
    shuffled = np.column_stack([np.zeros(len(states)), states[:, [1, 2, 0]]])
    pairs = pair_dimensions(actions, shuffled, NAMES, ("fixed", "j2", "gripper", "j1"))
    assert (pairs.actions, pairs.states) == ((0, 1, 2), (3, 1, 2))
    assert "shoulder = j1, elbow = j2, gripper." in pairs.note


@pytest.mark.parametrize("unit", [1.0, 1e-3, 1e-9])
def test_time_that_runs_at_another_rate(unit):
    actions, states = plain(3)
    clocks = {each: {"recorded_time": np.arange(112) / (0.9 * FPS) / unit + 1e5} for each in range(3)}
    report = report_of(recording(actions, states, clocks=clocks))
    (clock,) = report.findings.clocks
    assert clock.rate_hz == pytest.approx(0.9 * FPS, rel=1e-3)
    assert (report.verdict, report.exit_code) == ("fail", 11)
    assert "recorded at 18.0 frames a second by 'recorded_time', not at 20" in report.reasons[0]
    assert "11% too fast" in report.reasons[0]


def test_a_gap_in_time_is_a_warning_and_counted_time_says_nothing():
    actions, states = plain(3)
    time = np.arange(112) / FPS
    gap = {"clock_time": time + 0.2 * (np.arange(112) > 50), "timestamp": time}
    data = recording(actions, states, clocks=dict.fromkeys(range(3), gap))
    seen, counted = read_clocks(data)
    assert (seen.gaps, seen.backwards, seen.counted) == (3, 0, False)
    assert (counted.gaps, counted.counted) == (0, True)
    report = report_of(data)
    assert report.verdict == "warn"
    assert "frames are missing in 3 places, the longest gap is 0.25 s" in report.reasons[0]


def frames(n, *, seed=0, size=64):
    rng = np.random.default_rng(seed)
    return [rng.integers(0, 255, (size, size), dtype=np.uint8) for _ in range(n)]


def test_repeated_camera_frames():
    pictures = [each for each in frames(20) for _ in range(2)]
    found = compare(pictures, 3, np.ones(39, bool), FPS)
    assert (found.episode, found.frames, found.repeated, found.blank) == (3, 40, 0.5, 0.0)
    assert found.longest_still_s == 1 / FPS


def test_a_camera_that_freezes_counts_only_while_the_robot_moves():
    moving = np.arange(59) < 45
    pictures = [*frames(20), *frames(1) * 40]
    found = compare(pictures, 0, moving, FPS)
    assert found.still == pytest.approx(25 / 45)
    assert found.longest_still_s == 25 / FPS
    assert compare(pictures, 0, np.zeros(59, bool), FPS).still == 0


def test_noise_of_a_still_camera_is_no_motion_and_a_small_motion_is_one():
    rng = np.random.default_rng(0)
    base = rng.integers(50, 200, (64, 64))
    noisy = [(base + rng.integers(-1, 2, base.shape)).astype(np.uint8) for _ in range(10)]
    assert compare(noisy, 0, np.ones(9, bool), FPS).still == 1.0
    small = [base.astype(np.uint8).copy() for _ in range(10)]
    for place, picture in enumerate(small):
        picture[4:20, 5 * place : 5 * place + 16] = 255
    assert compare(small, 0, np.ones(9, bool), FPS).still == 0.0


def test_black_pictures_are_blank():
    black = [np.zeros((64, 64), np.uint8)] * 6
    assert compare([*black, *frames(6)], 0, np.ones(11, bool), FPS).blank == 0.5


def two_ways(n, *, apart=1.0, start=0.0, seed=0):
    rng = np.random.default_rng(seed)
    motions = []
    for episode in range(n):
        side = 1 if episode % 2 else -1
        steps = int(rng.integers(80, 140))
        time = np.linspace(0, 1, steps)
        detour = side * apart * np.sin(np.pi * time) + 0.1 * rng.normal() * time
        motions.append(np.column_stack([time, detour + side * start, 0.1 * rng.normal() * time]))
    return motions


def ways_of(motions):
    starts = np.stack([rows[0] for rows in motions])
    return count_ways(
        motions,
        starts + 1e-3 * np.random.default_rng(0).normal(size=starts.shape),
        np.ones(3),
        range(len(motions)),
    )


def test_two_planted_ways_are_two_and_one_is_one():
    found = ways_of(two_ways(24))
    assert found.number == 2
    assert {frozenset(group) for group in found.groups} == {
        frozenset(range(0, 24, 2)),
        frozenset(range(1, 24, 2)),
    }
    assert ways_of(two_ways(24, apart=0.0)).number == 1
    assert ways_of(two_ways(10)).number is None


def test_groups_that_begin_in_different_places_are_no_ways():
    found = ways_of(two_ways(24, start=1.0))
    assert (found.number, found.by_start, len(found.groups)) == (1, True, 2)


def test_an_odd_demonstration_is_no_way():
    motions = [*two_ways(24, apart=0.0), 5 + two_ways(1)[0]]
    assert ways_of(motions).number == 1


@pytest.mark.parametrize("seed", range(10))
def test_goals_all_over_a_table_are_one_way(seed):
    rng = np.random.default_rng(seed)
    time = np.linspace(0, 1, 60)[:, None]
    assert ways_of([time * [1, *rng.uniform(-1, 1, 2)] for _ in range(30)]).number == 1


def test_a_whole_operator_is_held_out():
    people = dict(enumerate("aaaaabbbcc"))
    split = split_by_operator(people)
    assert split is not None
    assert (split.held_out, split.validation, split.train) == ("c", [8, 9], list(range(8)))
    assert split_by_operator(dict.fromkeys(range(5), "a")) is None
