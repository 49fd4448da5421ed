"""A demonstrator of one episode: a controller with the pace, noise and pauses that were asked for."""

from collections import deque
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from lerobot_act_chunking.envs.demonstration import (
    ExpertOptions,
    Ranges,
    correlated_noise,
    wandering_pace,
)
from lerobot_act_chunking.envs.robotics.experts.controller import (
    CLOSE,
    OPEN,
    STILL,
    Controller,
    Move,
    Observation,
    Style,
    wait,
)
from lerobot_act_chunking.envs.robotics.experts.pick_and_place import pick_and_place
from lerobot_act_chunking.envs.robotics.experts.push import push
from lerobot_act_chunking.envs.robotics.experts.reach import reach
from lerobot_act_chunking.envs.robotics.experts.slide import slide
from lerobot_act_chunking.envs.robotics.tasks import get_task
from lerobot_act_chunking.errors import unknown_choice

EXPERTS: Mapping[str, Controller] = {
    "FetchReach-v4": reach,
    "FetchPush-v4": push,
    "FetchSlide-v4": slide,
    "FetchPickAndPlace-v4": pick_and_place,
}
"""The controller of every task that has an expert."""

RANGES: Ranges = {
    "speed": (0.5, 1.1, "times the nominal pace"),
    "waypoint_noise": (0.0, 0.03, "m"),
    "action_noise": (0.0, 0.15, "of the largest action"),
    "dwell": (0.0, 0.4, "s"),
    "dwell_after": (0.0, 0.4, "s"),
    "dwell_spread": (0.0, 0.7, "of the logarithm"),
    "pace_change": (0.0, 0.3, "of the logarithm"),
    "idle_start": (0.0, 0.4, "s"),
    "idle_end": (0.0, 1.5, "s"),
    "detour": (-0.05, 0.05, "m"),
    "overshoot": (0.0, 0.15, "of what is left of a movement"),
    "hand_noise": (0.0, 0.15, "of the largest action"),
    "tremor": (0.0, 0.3, "of the largest action"),
    "missed_grasps": (0, 1, "grasps"),
    "one_arm_first": (0, 1, "arms"),
    "constant_speed": (0, 1, "(no or yes)"),
    "stepwise": (0, 1, "(no or yes)"),
    "latency": (0.0, 0.04, "s"),
    "dropped_frames": (0.0, 0.2, "of the control steps"),
}
"""Outside these the experts fail too often to demonstrate anything."""

_FINGER_STEPS = 4  # control steps in which fingers close or open
_LARGEST_SHIFT = 0.05  # [m]; beyond it, a way-point would be led away from for good


class Expert:
    """Demonstrates one episode of a task.

    Without noise and pauses, an action is a function of the current observation. A pause of ``dwell`` seconds
    comes before the fingers close or the push begins, one of ``dwell_after`` when the block is grasped;
    FetchReach has neither, nor a free way-point. Only FetchPickAndPlace has a grasp that can be missed, and
    no task has a second arm, and a controller moves, so that ``constant_speed`` and ``stepwise`` change
    nothing. All episodes last equally long, so that ``idle_end`` is what is left of them.

    Args:
        task: one of ``EXPERTS``.
        options: pace, noise and pauses.
        rng: source of the noise; a noise-free expert draws nothing from it.
        steps: control steps of the episode.

    Raises:
        ConfigurationError: no expert for this task, or options outside their ranges.
    """

    def __init__(self, task: str, options: ExpertOptions, rng: np.random.Generator, steps: int) -> None:
        if task not in EXPERTS:
            raise unknown_choice("task with an expert", task, EXPERTS)
        options.check(RANGES)
        period = 1 / get_task(task).fps
        self._controller = EXPERTS[task]
        self._style = Style(options.speed, _shift(options, rng), options.overshoot)
        noise, hand = np.zeros((steps, 4)), np.zeros((steps, 4))
        if options.action_noise > 0:
            noise[:, :3] = correlated_noise((steps, 3), options.action_noise, rng, period=period)
        hand[:, :3] = options.hand((steps, 3), rng, period=period)
        paces = np.ones(steps)
        if options.pace_change:
            paces = wandering_pace(period * np.arange(steps), options.pace_change, rng)
        self._noise, self._hand, self._paces = iter(noise), iter(hand), iter(paces)
        self._idle_left = round(options.idle_start / period)
        self._pause_left = round(options.pause(options.dwell, rng) / period)
        self._pause_after_left = round(options.pause(options.dwell_after, rng) / period)
        self._miss_left = 2 * _FINGER_STEPS * options.missed_grasps
        self._late = deque([wait(STILL).astype(np.float32)] * round(options.latency / period))

    def act(self, observation: Observation) -> tuple[np.ndarray, np.ndarray]:
        """The clean action (4,), which is what a dataset records, and the disturbed one to execute.

        In single precision, as datasets keep them, so that what is recorded is what was done.
        """
        speed = min(self._style.speed * next(self._paces), RANGES["speed"][1])
        move = self._controller(observation, replace(self._style, speed=speed))
        action = np.clip(self._rest(move) + next(self._hand), -1.0, 1.0).astype(np.float32)
        command = np.clip(action + next(self._noise), -1.0, 1.0).astype(np.float32)
        self._late.append(command)
        return action, self._late.popleft()

    def _rest(self, move: Move) -> np.ndarray:
        """What is done here: the controller's action, or a rest, a pause or a missed grasp in its place."""
        if self._idle_left:
            self._idle_left -= 1
            return wait(move.action[3])
        if self._miss_left and (move.misses or self._miss_left < 2 * _FINGER_STEPS):
            self._miss_left -= 1
            return wait(CLOSE if self._miss_left >= _FINGER_STEPS else OPEN)
        if move.pause is not None and self._pause_left:
            self._pause_left -= 1
            return move.pause
        if move.pause_after is not None and self._pause_after_left:
            self._pause_after_left -= 1
            return move.pause_after
        return move.action


def _shift(options: ExpertOptions, rng: np.random.Generator) -> np.ndarray:
    shift = np.array([0.0, options.detour, 0.0])
    if options.waypoint_noise > 0:
        shift += options.waypoint_noise * rng.standard_normal(3)
    return shift * min(1.0, _LARGEST_SHIFT / max(float(np.linalg.norm(shift)), 1e-9))
