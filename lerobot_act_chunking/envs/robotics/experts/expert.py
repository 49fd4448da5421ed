"""A demonstrator of one episode: a controller with the pace, noise and pauses that were asked for."""

from collections.abc import Mapping

import numpy as np

from lerobot_act_chunking.envs.demonstration import ExpertOptions, Ranges, correlated_noise
from lerobot_act_chunking.envs.robotics.experts.controller import Controller, Observation, Style
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
}
"""Outside these the experts fail too often to demonstrate anything."""

_LARGEST_SHIFT = 0.05  # [m]; beyond it, a way-point would be led away from for good


class Expert:
    """Demonstrates one episode of a task.

    Without noise and pauses, an action is a function of the current observation. A pause is one of
    ``dwell`` seconds before the fingers close or the push begins; FetchReach has none, nor a free way-point.

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
        self._style = Style(options.speed, _shift(options.waypoint_noise, rng))
        self._pause_left = round(options.dwell / period)
        noise = np.zeros((steps, 4))
        if options.action_noise > 0:
            noise[:, :3] = correlated_noise((steps, 3), options.action_noise, rng, period=period)
        self._noise = iter(noise)

    def act(self, observation: Observation) -> tuple[np.ndarray, np.ndarray]:
        """The clean action (4,), which is what a dataset records, and the disturbed one to execute.

        In single precision, as datasets keep them, so that what is recorded is what was done.
        """
        move = self._controller(observation, self._style)
        action = np.clip(move.action, -1.0, 1.0)
        if move.pause is not None and self._pause_left:
            self._pause_left -= 1
            action = move.pause
        command = np.clip(action + next(self._noise), -1.0, 1.0)
        return action.astype(np.float32), command.astype(np.float32)


def _shift(scale: float, rng: np.random.Generator) -> np.ndarray:
    if scale == 0:
        return np.zeros(3)
    shift = scale * rng.standard_normal(3)
    return shift * min(1.0, _LARGEST_SHIFT / float(np.linalg.norm(shift)))
