"""Recordings with planted properties."""

import numpy as np

from lerobot_act_chunking.diagnostics.core.recording import Episode, Recording
from lerobot_act_chunking.diagnostics.data.measuring import measure, measure_motion

FPS = 20
NAMES = ("shoulder", "elbow", "gripper")


def reach(rng, steps=120):
    """(steps, 3): two joints that go smoothly from the start to an end, and a gripper that closes."""
    time = np.linspace(0, 1, steps)
    eased = time**2 * (3 - 2 * time)
    ends = [1.0, -2.0] + 0.2 * rng.normal(size=2)
    joints = eased[:, None] * ends + 0.1 * np.sin(2 * np.pi * (1 + rng.uniform()) * time)[:, None]
    gripper = np.clip(10 * (time - 0.6), 0, 1)
    return np.column_stack([joints, gripper])


def held(rows, where, steps):
    """The same with a row repeated."""
    return np.concatenate([rows[:where], np.repeat(rows[where : where + 1], steps, axis=0), rows[where:]])


def recording(actions, states=None, *, names=NAMES, state_names=None, clocks=None, operators=None):
    states = actions if states is None else states
    episodes = tuple(
        Episode(index, action, state, (clocks or {}).get(index, {}))
        for index, (action, state) in enumerate(zip(actions, states, strict=True))
    )
    return Recording("data/planted", FPS, names, state_names or names, episodes, operators or {})


def motion_of(recorded):
    return measure_motion(
        recorded.actions, [each.index for each in recorded.episodes], FPS, recorded.action_names
    )


def report_of(recorded, *, broken=None, cameras=()):
    return measure(recorded, motion_of(recorded), broken or {}, list(cameras))


def later(rows, lags):
    """Each dimension that many steps later."""
    return np.stack(
        [
            np.concatenate([np.repeat(rows[:1, dim], lag), rows[: len(rows) - lag, dim]])
            for dim, lag in enumerate(lags)
        ],
        axis=1,
    )


def plain(n=12, seed=0):
    """Demonstrations without anything to find: no rests, a lag of two steps, and states a little short."""
    rng = np.random.default_rng(seed)
    actions = [reach(rng)[4:-4] for _ in range(n)]
    return actions, [later(0.98 * rows, (2, 2, 2)) for rows in actions]
