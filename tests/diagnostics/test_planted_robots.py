"""Random robots with planted motion, lags, noise and parked parts: what instruments say of them is true."""

import dataclasses

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from tiers import draws

from lerobot_act_chunking.data.dimension_names import dimension_names
from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.diagnostics.codebook.chunks import CodedChunks, cut_chunks
from lerobot_act_chunking.diagnostics.codebook.losses import measure_losses
from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes
from lerobot_act_chunking.diagnostics.core.measures import RawUnits
from lerobot_act_chunking.diagnostics.core.noise_floor import measure_noise
from lerobot_act_chunking.diagnostics.core.rollouts import Rollout
from lerobot_act_chunking.diagnostics.resolution.measuring import measure as measure_resolution
from lerobot_act_chunking.diagnostics.resolution.settings import Criteria
from lerobot_act_chunking.diagnostics.smoothness.measuring import measure

ROBOTS = draws(gate=20, full=300)
FPS = (10, 15, 20, 30, 50)
KINDS = ("constant", "parked", "tremor", "quantised")


@dataclasses.dataclass
class Robot:
    """Episodes with a planted answer.

    Attributes:
        fps: control steps per second.
        commands: (L, A) of each episode.
        positions: the same, later by each joint's lag.
        lags: of each moving joint, in control steps.
    """

    fps: int
    commands: list[np.ndarray]
    positions: list[np.ndarray]
    lags: list[int]

    @property
    def names(self) -> list[str]:
        return [f"joint_{dim}" for dim in range(self.commands[0].shape[1])]


def motion(rng, steps: int, fps: int, dims: int) -> np.ndarray:
    """Random smooth motion, of half a second and slower."""
    smooth = gaussian_filter1d(rng.normal(size=(steps, dims)), 0.35 * fps, axis=0)
    return smooth / smooth.std(0) * 10.0 ** rng.uniform(-3, 3, dims)


def plant(seed: int, *, lagging: bool = True) -> Robot:
    rng = np.random.default_rng(seed)
    fps, dims = int(rng.choice(FPS)), int(rng.integers(2, 6))
    lags = [int(lag) for lag in rng.integers(1, max(2, int(1.5 * fps)), dims)] if lagging else [1] * dims
    commands, positions = [], []
    for _ in range(rng.integers(3, 7)):
        steps, before = int(rng.integers(10 * fps, 18 * fps)), 2 * fps
        path = motion(rng, steps + before, fps, dims)
        commands.append(path[before:])
        delayed = [path[before - lag : before - lag + steps, dim] for dim, lag in enumerate(lags)]
        positions.append(np.stack(delayed, axis=1) + 0.003 * path.std(0) * rng.normal(size=(steps, dims)))
    return Robot(fps, commands, positions, lags)


def extra(rng, kind: str, steps: int) -> np.ndarray:
    """One more dimension that does not move: values (L,)."""
    unit = 10.0 ** rng.uniform(-3, 3)
    tremor = rng.normal(size=steps)
    values = {
        "constant": np.zeros(steps),
        "parked": tremor + 0.2 * np.linspace(0, rng.normal(), steps),
        "tremor": 0.3 * np.sign(tremor) + tremor,
        "quantised": np.round(0.6 * tremor),
    }[kind]
    return unit * (values + 3.0)


def with_extras(robot: Robot, seed: int) -> Robot:
    """The same robot with a parked limb behind its joints."""
    rng = np.random.default_rng(seed)
    kinds = rng.choice(KINDS, int(rng.integers(1, 5)))
    longer = []
    for parts in (robot.commands, robot.positions):
        longer.append(
            [np.column_stack([rows, *(extra(rng, kind, len(rows)) for kind in kinds)]) for rows in parts]
        )
    return Robot(robot.fps, *longer, robot.lags)


def smoothness(robot: Robot):
    rollouts = [
        Rollout(seed, 1 / robot.fps, command, position, np.zeros(len(command)), success=False)
        for seed, (command, position) in enumerate(zip(robot.commands, robot.positions, strict=True))
    ]
    std = np.concatenate(robot.commands).std(0)
    floor = measure_noise(robot.commands, robot.fps, robot.names)
    return measure(rollouts, action_std=std, joint_names=robot.names, floor=floor)


def demonstrations(robot: Robot) -> ActionEpisodes:
    return ActionEpisodes("planted", float(robot.fps), robot.names, dict(enumerate(robot.commands)))


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


@pytest.mark.parametrize("seed", range(ROBOTS))
def test_what_codes_lose_lies_between_nothing_and_all(seed):
    """Codes that say anything at all, of a robot with parked parts."""
    robot = plant(seed)
    longer = with_extras(robot, seed)
    rng = np.random.default_rng(seed)
    lost = []
    for each in (robot, longer):
        data = demonstrations(each)
        chunks = cut_chunks(data, ChunkTiming(1, 5), 100)
        varies = chunks.actions.var((0, 1))
        wrong = 10.0 ** rng.uniform(-2, 4, len(each.names)) * varies
        wrong[: len(robot.names)] = varies[: len(robot.names)] * 0.25
        errors = np.tile(wrong, (len(chunks), 1))
        codes = np.zeros((len(chunks), 2), int)
        found = measure_losses(
            CodedChunks(chunks, codes, chunks.actions, errors, varies), data, RawUnits(each.names)
        )
        shares = [loss.lost_variance for loss in found.dimensions if loss.lost_variance is not None]
        assert all(0 <= share <= 1 for share in shares)
        lost.append(found.lost_variance)
    assert lost == pytest.approx([0.25, 0.25])


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
