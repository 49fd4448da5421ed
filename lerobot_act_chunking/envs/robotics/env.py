"""Any world of gymnasium-robotics as a Gymnasium environment that LeRobot understands."""

from typing import Any

import gymnasium as gym
import numpy as np

from lerobot_act_chunking.envs.robotics.failures import FAILURES, Progress
from lerobot_act_chunking.envs.robotics.options import RoboticsOptions
from lerobot_act_chunking.envs.robotics.original import make_original
from lerobot_act_chunking.envs.robotics.tasks import get_task
from lerobot_act_chunking.envs.robotics.views import Views
from lerobot_act_chunking.envs.spaces import observation_space
from lerobot_act_chunking.errors import FeatureError, unknown_choice


class RoboticsEnv(gym.Env):
    """A world of gymnasium-robotics: its physics, actions, rewards and time limit, LeRobot's observations.

    Observations: ``agent_pos``, the robot's own part of the original observation; ``environment_state``, the
    rest of it and the desired goal; ``pixels`` {camera: uint8 (height, width, 3)}. ``layout`` of the
    environment says which number is what; ``named_state`` has the present ones by name, whatever is observed.

    Info: ``success_any``, whether a step of this episode has succeeded by now; ``success_final``, whether
    this step does; and ``is_success``, as chosen by ``success``: with ``any`` it is ``success_any`` and ends
    the episode, with ``final`` it is ``success_final`` at the episode's last step and False before, so that
    LeRobot, which asks whether any step had ``is_success``, counts the last one alone. All are False at
    reset: no step has been taken.

    Failure: ``failure``, one of ``FAILURES`` of the tasks that can tell; the others have no such attribute.

    Seeds: ``reset(seed=s)`` starts the episode that the original starts for ``s``.

    Args:
        render_mode: "rgb_array" or None.
        options: fields of ``RoboticsOptions``.

    Raises:
        ConfigurationError: an option that cannot work, or gymnasium-robotics is not installed.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 25}  # noqa: RUF012  (Gymnasium declares it so)

    def __init__(self, render_mode: str | None = "rgb_array", **options: Any) -> None:
        if render_mode not in (None, "rgb_array"):
            raise unknown_choice("render_mode", render_mode, ("rgb_array", "None"))
        self.render_mode = render_mode
        self.options = RoboticsOptions(**options)
        self.task = self.options.task
        self.layout = self.options.layout
        self._complete = get_task(self.task)
        self.task_description = self.layout.instruction
        self.metadata = {**self.metadata, "render_fps": self.layout.fps}
        self.max_episode_steps = self.options.episode_length or self.layout.episode_length
        self._max_episode_steps = self.max_episode_steps  # LeRobot reads it under this name
        self.original = make_original(self.task)
        self._progress: Progress | None = None
        self._views = Views(self.original, self.options)
        self.action_space = self.original.action_space
        states = {"agent_pos": len(self.layout.state_names)}
        self.observation_space = observation_space(self.options, states, len(self.layout.environment_names))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start an episode, the one that the original starts for ``seed`` and ``options``."""
        super().reset(seed=seed)
        self._steps = 0
        self._succeeded = self._succeeds = False
        observation, _ = self.original.reset(seed=seed, options=options)
        observed = self._observe(observation)
        self._progress = Progress(self.task, self.named_state) if self.task in FAILURES else None
        return observed, self._info(over=False)

    def step(self, action: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Advance one control step; the original clips actions to -1 .. 1.

        Raises:
            FeatureError: an action of the wrong shape or not finite.
        """
        observation, reward, terminated, _, info = self.original.step(self._checked(action))
        self._succeeds = self.layout.succeeds(info)
        self._steps += 1
        self._succeeded = self._succeeded or self._succeeds
        terminated = bool(terminated) or (self.options.success == "any" and self._succeeded)
        truncated = self._steps >= self.max_episode_steps
        info = self._info(over=terminated or truncated)
        observed = self._observe(observation)
        if self._progress is not None:
            self._progress.update(self.named_state, at_goal=self._succeeds)
        return observed, float(reward), terminated, truncated, info

    def render(self) -> np.ndarray | None:
        """The ``view`` camera at visualization size, uint8 (height, width, 3); None without a render mode."""
        if self.render_mode is None:
            return None
        size = self.options.visualization_height, self.options.visualization_width
        return self._views.images(["view"], *size)["view"]

    @property
    def named_state(self) -> dict[str, np.ndarray]:
        """Every part of the present state and the goal by its name, whatever is observed."""
        return self._complete.named(*self._complete.split(self._original_observation))

    @property
    def failure(self) -> str | None:
        """How far this episode got, one of the task's ``FAILURES``; None where it succeeds.

        Raises:
            AttributeError: the task is not among them, or no episode has begun.
        """
        if self._progress is None:
            raise AttributeError(f"the present episode of {self.task} cannot tell how it failed")
        succeeds = self._succeeded if self.options.success == "any" else self._succeeds
        return None if succeeds else self._progress.failure

    def close(self) -> None:
        """Free the simulation's and the images' resources."""
        self._views.close()
        self.original.close()

    def _info(self, over: bool) -> dict[str, Any]:
        chosen = self._succeeded if self.options.success == "any" else self._succeeds and over
        return {"is_success": chosen, "success_any": self._succeeded, "success_final": self._succeeds}

    def _observe(self, original: Any) -> dict[str, Any]:
        self._original_observation = original
        agent_pos, environment_state = self.layout.split(original)
        observation: dict[str, Any] = {}
        if self.options.obs_type != "pixels":
            observation["agent_pos"] = agent_pos
        if self.options.obs_type == "state":
            observation["environment_state"] = environment_state
        else:
            size = self.options.observation_height, self.options.observation_width
            observation["pixels"] = self._views.images(self.options.cameras, *size)
        return observation

    def _checked(self, action: np.ndarray) -> np.ndarray:
        action = np.asarray(action)
        names = self.layout.actions
        if action.shape != (len(names),):
            raise FeatureError(f"an action of {self.task} has shape {(len(names),)}, got {action.shape}")
        if not np.isfinite(action).all():
            bad = [name for name, value in zip(names, action, strict=True) if not np.isfinite(value)]
            raise FeatureError(f"the action is not finite at {', '.join(bad)}")
        return action
