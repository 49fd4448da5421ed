from dataclasses import asdict, fields

import numpy as np
import pytest

from lerobot_act_chunking.envs.aloha.experts import RANGES as ALOHA
from lerobot_act_chunking.envs.aloha.experts import plan
from lerobot_act_chunking.envs.aloha.experts.planner import MAX_STEPS
from lerobot_act_chunking.envs.aloha.tasks import TASKS, sample_object_pose
from lerobot_act_chunking.envs.demonstration import ExpertOptions, tremor, wandering_pace
from lerobot_act_chunking.envs.operators import OPERATORS, get_operator
from lerobot_act_chunking.envs.robotics.experts import RANGES as FETCH
from lerobot_act_chunking.errors import ConfigurationError

every_operator = pytest.mark.parametrize("name", OPERATORS)


def episodes(name, count=50, ranges=ALOHA, seed=0):
    rng = np.random.default_rng(seed)
    return [get_operator(name).episode(rng, ranges) for _ in range(count)]


def planned(task="transfer_cube", seed=0, **options):
    rng = np.random.default_rng(seed)
    return plan(task, sample_object_pose(task, np.random.default_rng(5)), ExpertOptions(**options), rng)


def test_steady_is_the_expert_as_it_is():
    assert set(episodes("steady")) == {ExpertOptions()}


@every_operator
@pytest.mark.parametrize("ranges", [ALOHA, FETCH], ids=["aloha", "fetch"])
def test_every_episode_is_within_what_the_expert_bears(name, ranges):
    for options in episodes(name, 200, ranges):
        options.check(ranges)


@every_operator
def test_the_same_seed_gives_the_same_episodes(name):
    assert episodes(name, seed=3) == episodes(name, seed=3)
    assert (name == "steady") == (episodes(name, seed=3) == episodes(name, seed=4))


def test_every_habit_is_somebodys():
    habits = {entry.name for entry in fields(ExpertOptions)} - {"action_noise"}  # DART's, not a person's
    shown = {habit for name in OPERATORS for options in episodes(name) for habit in habits
             if getattr(options, habit) != getattr(ExpertOptions(), habit)}  # fmt: skip
    assert shown == habits


@every_operator
@pytest.mark.parametrize("task", TASKS)
def test_every_plan_fits_an_episode(name, task):
    rng = np.random.default_rng(0)
    for options in episodes(name, 30):
        actions = plan(task, sample_object_pose(task, rng), options, rng).actions
        assert 150 < len(actions) <= MAX_STEPS
        assert np.isfinite(actions).all()


def test_an_unknown_person_is_refused_with_the_names():
    with pytest.raises(ConfigurationError, match="unknown operator 'bob'; choose one of: steady, unhurried"):
        get_operator("bob")


def test_rests_are_still_and_the_rest_of_the_plan_is_the_same():
    rested, plain = planned(idle_start=0.5, idle_end=0.4).actions, planned().actions
    assert np.ptp(rested[:25], axis=0).max() == 0
    assert np.ptp(rested[-20:], axis=0).max() == 0
    # The motion begins 0.25 s before the plan without rests joins it: 12.5 steps.
    np.testing.assert_allclose(rested[25 + 12 : 25 + 212], plain[:200], atol=5e-2)
    assert np.abs(rested[25:225] - plain[:200]).max() > 0.1


def test_a_missed_grasp_opens_again_and_takes_longer():
    missed, plain = planned(missed_grasps=1).actions, planned().actions
    assert len(missed) - len(plain) == 60
    closings = [int(np.sum(np.diff((each[:, 13] < 0.5).astype(int)) == 1)) for each in (plain, missed)]
    assert closings == [1, 2]
    np.testing.assert_allclose(missed[-1], plain[-1], atol=1e-9)


def test_commands_come_late_and_labels_do_not():
    late = planned(latency=0.1)
    np.testing.assert_array_equal(late.actions, planned().actions)
    np.testing.assert_array_equal(late.commands[5:], late.actions[:-5])
    assert np.all(late.commands[:5] == late.actions[0])


def test_a_detour_is_over_before_the_fingers_close():
    sides = [planned(detour=detour).actions for detour in (-0.08, 0.0, 0.08)]
    away = np.abs(sides[0] - sides[2]).max(axis=1)
    assert away[30] > 0.1
    assert away[170:].max() < 1e-9  # of the left arm, which takes the cube over
    assert np.abs(sides[0] - sides[2])[75:, 7:].max() < 1e-9
    assert np.sign(sides[0][30, 7] - sides[1][30, 7]) == -np.sign(sides[2][30, 7] - sides[1][30, 7])


def test_an_overshoot_goes_too_far_and_comes_back():
    far, plain = planned(overshoot=0.1).actions, planned().actions
    assert np.abs(far - plain).max() > 0.02
    np.testing.assert_allclose(far[-1], plain[-1], atol=1e-9)


def test_the_hand_is_recorded_and_executed():
    shaky = planned(hand_noise=0.01, tremor=0.005)
    np.testing.assert_array_equal(shaky.actions, shaky.commands)
    assert np.abs(shaky.actions - planned().actions)[:, :6].std() > 0.003
    np.testing.assert_array_equal(shaky.actions[:, [6, 13]], planned().actions[:, [6, 13]])


def test_a_tremor_is_in_the_actions():
    shaking = (planned(tremor=0.005).actions - planned().actions)[:, :6]
    assert 0.003 < shaking.std() < 0.007
    assert np.abs(np.diff(shaking, axis=0)).mean() > 0.002  # fast


def test_a_program_stands_still_in_its_pauses_and_moves_at_constant_speed():
    actions = planned(constant_speed=1, speed=1.3, dwell=0.8, dwell_after=0.9).actions
    still = np.abs(np.diff(actions, axis=0)).max(axis=1) < 2e-3
    runs = "".join(".x"[int(each)] for each in still).split(".")
    assert [len(run) for run in runs if len(run) > 2] == [39, 45, 39, 45]  # pauses of 40 and 45 steps
    jumps, smooth = (
        np.abs(np.diff(planned(constant_speed=each).actions[:, :6], n=2, axis=0)).max() for each in (1, 0)
    )
    assert jumps > 3 * smooth


def test_step_by_step_the_arm_rests_at_every_way_point():
    def rests(**options):
        moved = np.abs(np.diff(planned(**options).actions[:, 7:13], axis=0)).max(axis=1) < 5e-4
        return len([run for run in "".join(".x"[int(each)] for each in moved).split(".") if len(run) > 2])

    # Before the start, above the cube, at it, above it again, and until the cube is given.
    assert rests(stepwise=1) == 5
    assert rests() == 0


def test_one_arm_waits_until_the_other_has_grasped():
    plain, waiting = planned().actions, planned(one_arm_first=1).actions
    assert 90 <= len(waiting) - len(plain) <= 94
    assert np.ptp(waiting[:80, :7], axis=0).max() < 1e-9
    np.testing.assert_allclose(waiting[:140, 7:], plain[:140, 7:], atol=1e-9)
    np.testing.assert_allclose(waiting[-1], plain[-1], atol=2e-2)


def test_a_two_sided_person_comes_from_both_sides():
    sides = [np.sign(options.detour) for options in episodes("two_sided")]
    assert 10 < sides.count(1) < 40
    assert sides.count(1) + sides.count(-1) == 50
    assert {options.detour for options in episodes("brisk")} == {0.0}


@pytest.mark.parametrize("period", [0.02, 0.04])
def test_a_tremor_has_its_deviation_and_its_band(period):
    noise = tremor((4000, 3), 0.01, np.random.default_rng(0), period=period)
    np.testing.assert_allclose(noise.std(axis=0), 0.01, rtol=0.15)
    power = (np.abs(np.fft.rfft(noise, axis=0)) ** 2).sum(axis=1)
    frequencies = np.fft.rfftfreq(len(noise), period)
    inside = (frequencies > 5) & (frequencies < 12)
    assert power[inside].sum() > 0.9 * power.sum()


def test_a_wandering_pace_stays_around_its_mean_and_is_slow():
    pace = wandering_pace(np.arange(0, 200, 0.02), 0.2, np.random.default_rng(0))
    assert abs(np.log(pace).std() - 0.2) < 0.05
    assert np.abs(np.diff(pace)).max() < 0.03


def test_a_recording_names_young_options_only_where_they_are_set():
    assert ExpertOptions().settings() == {
        "speed": 1.0, "waypoint_noise": 0.0, "action_noise": 0.0, "dwell": 0.0
    }  # fmt: skip
    assert ExpertOptions(latency=0.1).settings()["latency"] == 0.1
    everything = asdict(ExpertOptions())
    assert all(ExpertOptions(**{name: 0.1}).settings()[name] == 0.1 for name in everything)
