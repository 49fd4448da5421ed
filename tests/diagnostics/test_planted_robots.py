"""Random robots with a planted answer: what instruments say of them is true."""

import numpy as np
import pytest
from planted_robots import ROBOTS, Robot, demonstrations, plant, with_extras

from lerobot_act_chunking.data.dimension_names import dimension_names
from lerobot_act_chunking.diagnostics.core.noise_floor import measure_noise
from lerobot_act_chunking.diagnostics.core.rollouts import Rollout
from lerobot_act_chunking.diagnostics.resolution.measuring import measure as measure_resolution
from lerobot_act_chunking.diagnostics.resolution.settings import Criteria
from lerobot_act_chunking.diagnostics.smoothness.measuring import measure


def smoothness(robot: Robot):
    rollouts = [
        Rollout(seed, 1 / robot.fps, command, position, np.zeros(len(command)), success=False)
        for seed, (command, position) in enumerate(zip(robot.commands, robot.positions, strict=True))
    ]
    std = np.concatenate(robot.commands).std(0)
    floor = measure_noise(robot.commands, robot.fps, robot.names)
    return measure(rollouts, action_std=std, joint_names=robot.names, floor=floor)


@pytest.mark.parametrize("seed", range(ROBOTS))
def test_a_planted_lag_is_found_or_called_unknown(seed):
    robot = plant(seed)
    report = smoothness(robot)
    for name, lag in zip(robot.names, robot.lags, strict=True):
        found = report.tracking_lag_s[name]
        assert found is None or abs(found * robot.fps - lag) <= 1, (found, lag / robot.fps)
        assert (found is None) == (f"tracking_lag_s.{name}" in report.undefined)
    known = [name for name in robot.names if report.tracking_lag_s[name] is not None]
    assert len(known) >= len(robot.names) - 1
    assert sorted(joint for group in report.lag_groups for joint in group.joints) == sorted(known)


@pytest.mark.parametrize("seed", range(ROBOTS))
def test_parts_that_do_not_move_change_nothing_for_the_others(seed):
    robot = plant(seed)
    longer = with_extras(robot, seed + 1)
    moving = len(robot.names)
    floor = measure_noise(longer.commands, longer.fps, longer.names)
    assert floor.moving == list(range(moving))
    one, other = smoothness(robot), smoothness(longer)
    assert other.commanded.arms == one.commanded.arms
    assert other.achieved.arms == one.achieved.arms
    assert other.lag_groups == one.lag_groups
    criteria = Criteria(horizon_s=1.0)
    alone, together = (measure_resolution(demonstrations(each), criteria) for each in (robot, longer))
    assert (together.verdict, together.reasons) == (alone.verdict, alone.reasons)
    assert together.recommended.stride == alone.recommended.stride


@pytest.mark.parametrize("seed", range(ROBOTS))
def test_units_change_nothing_that_is_relative(seed):
    robot = with_extras(plant(seed, lagging=False), seed)
    rng = np.random.default_rng(seed)
    units = 2.0 ** rng.integers(-8, 9, len(robot.names))
    scaled = Robot(
        robot.fps,
        *([rows * units for rows in part] for part in (robot.commands, robot.positions)),
        robot.lags,
    )
    floors = [measure_noise(each.commands, each.fps, each.names).dimensions for each in (robot, scaled)]
    for one, other in zip(*floors, strict=True):
        assert (one.kind, one.switches, one.noise) == (other.kind, other.switches, pytest.approx(other.noise))
    one, other = smoothness(robot), smoothness(scaled)
    for name in ("rms_jerk", "log_dimensionless_jerk", "sparc", "energy_above_5_hz"):
        assert getattr(one.commanded.arms, name) == pytest.approx(getattr(other.commanded.arms, name))
    assert one.tracking_lag_s == pytest.approx(other.tracking_lag_s)
    criteria = Criteria(horizon_s=1.0)
    alone, together = (measure_resolution(demonstrations(each), criteria) for each in (robot, scaled))
    assert (together.verdict, together.recommended.stride) == (alone.verdict, alone.recommended.stride)


@pytest.mark.parametrize("seed", range(ROBOTS))
def test_an_action_that_is_the_next_state_has_no_lag(seed):
    robot = plant(seed)
    later = int(np.random.default_rng(seed).integers(0, 3))
    robot.positions = [
        np.concatenate([rows[:1].repeat(later, 0), rows])[: len(rows)] for rows in robot.commands
    ]
    report = smoothness(robot)
    assert set(report.tracking_lag_s.values()) == {None}
    assert f"the state {later} step(s) later, to the bit" in report.notes[-1]


@pytest.mark.parametrize(
    ("names", "found"),
    [
        (["a", "b", "c"], ("a", "b", "c")),
        ([["a", "b", "c"]], ("a", "b", "c")),
        ([["a"], ["b", "c"]], ("a", "b", "c")),
        ({"motors": ["a", "b", "c"]}, ("a", "b", "c")),
        ({"left": ["a"], "right": {"motors": ["b", "c"]}}, ("a", "b", "c")),
        ({"a": 0, "b": 1, "c": 2}, ("a", "b", "c")),
        (["a", "a", "b"], ("a_0", "a_1", "b")),
        (None, ("action_0", "action_1", "action_2")),
        (["a", "b"], ("action_0", "action_1", "action_2")),
    ],
)
def test_names_are_found_however_lerobot_holds_them(names, found):
    assert dimension_names({"shape": (3,), "names": names}) == found
