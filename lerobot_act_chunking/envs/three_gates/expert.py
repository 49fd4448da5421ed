"""The scripted expert of the three gates: straight through the gate that it is told."""

from dataclasses import asdict

import numpy as np

from lerobot_act_chunking.envs.demonstration import ExpertOptions, Ranges, correlated_noise, minimum_jerk
from lerobot_act_chunking.envs.three_gates.world import FPS, GATES
from lerobot_act_chunking.errors import unknown_choice

RANGES: Ranges = {
    **{name: (usual, usual, "in three_gates") for name, usual in asdict(ExpertOptions()).items()},
    "speed": (0.7, 1.5, "times the nominal pace"),
    "waypoint_noise": (0.0, 0.05, "m"),
    "action_noise": (0.0, 0.02, "m"),
    "hand_noise": (0.0, 0.02, "m"),
    "idle_start": (0.0, 0.5, "s"),
    "dropped_frames": (0.0, 0.2, "of the control steps"),
}
"""Outside these the expert fails too often to demonstrate anything, or has nothing that they change."""

_DURATION = 2.2  # [s] at nominal pace
_BEYOND = 1.5  # where the movement ends, as a multiple of the gate's distance from the middle


def plan(
    start: np.ndarray, options: ExpertOptions, rng: np.random.Generator, *, mode: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Targets of one episode, ten a second.

    Args:
        start: (2,) where the mass is [m].
        options: pace, noise and rest; way-point noise leads the way to the gate around to a side.
        rng: source of the noise; a noise-free plan draws nothing from it.
        mode: the gate.

    Returns:
        The clean targets (T, 2), which a dataset records, and the disturbed ones to execute.

    Raises:
        ConfigurationError: no such gate, or options outside their ranges.
    """
    options.check(RANGES)
    if not 0 <= mode < len(GATES):
        raise unknown_choice("mode of three_gates", mode, map(str, range(len(GATES))))
    period = 1 / FPS
    steps = round(_DURATION / options.speed / period)
    progress = minimum_jerk(np.arange(1, steps + 1) / steps)[:, None]
    actions = start + progress * (_BEYOND * GATES[mode] - start)
    if options.waypoint_noise > 0:
        to_gate = np.clip(_BEYOND * progress, 0, 1)
        actions += 16 * (to_gate * (1 - to_gate)) ** 2 * options.waypoint_noise * rng.standard_normal(2)
    actions = np.concatenate([np.tile(start, (round(options.idle_start / period), 1)), actions])
    shape = (len(actions), 2)
    actions += options.hand(shape, rng, period=period)
    commands = actions.copy()
    if options.action_noise > 0:
        commands += correlated_noise(shape, options.action_noise, rng, period=period)
    return actions, commands
