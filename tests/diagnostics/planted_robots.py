"""Random robots with planted motion, lags, noise and parked parts."""

import dataclasses

import numpy as np
from scipy.ndimage import gaussian_filter1d
from tiers import draws

from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes

ROBOTS = draws(gate=8, full=300)
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


def demonstrations(robot: Robot) -> ActionEpisodes:
    return ActionEpisodes("planted", float(robot.fps), robot.names, dict(enumerate(robot.commands)))
