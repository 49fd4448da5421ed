"""The three gates as a Gymnasium environment."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from lerobot_act_chunking.envs.rendering import Images
from lerobot_act_chunking.envs.spaces import observation_space
from lerobot_act_chunking.envs.three_gates.options import CAMERA, ThreeGatesOptions
from lerobot_act_chunking.envs.three_gates.world import (
    FPS,
    IN_A_GATE,
    LIMIT,
    START_RADIUS,
    ThreeGatesWorld,
    gate_of,
)
from lerobot_act_chunking.errors import unknown_choice

INSTRUCTION = "Leave the ring through any gate."
FAILURES = (
    "stayed inside",  # the mass never touched the wall
    "met the wall",  # it did, and is inside
    "stuck in a gate",  # it is between two ends of the wall
)
"""In the order of how far an episode got."""


class ThreeGatesEnv(gym.Env):
    """A point mass starts near the middle of a ring and leaves it through any of three gates, 10 Hz.

    Observations: ``agent_pos`` (2,) [m]; ``environment_state`` (6,), x and y of each gate as seen from the
    mass; on request ``agent_vel`` (2,) [m/s] and ``pixels`` {"top": uint8 (height, width, 3)}.

    Actions: (2,), the position to move to [m].

    Info: ``mode``, the gate behind which the mass is, 0 (up), 1 (lower left) or 2 (lower right), -1 inside;
    and ``is_success``, whether it is behind any, which ends the episode. The reward is 1 there.

    Failure: ``failure``, one of ``FAILURES``, or None once the episode has succeeded.

    Args:
        render_mode: "rgb_array" or None.
        options: fields of ``ThreeGatesOptions``.

    Raises:
        ConfigurationError: an option that cannot work.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": FPS}  # noqa: RUF012  (Gymnasium declares it so)

    def __init__(self, render_mode: str | None = "rgb_array", **options: Any) -> None:
        if render_mode not in (None, "rgb_array"):
            raise unknown_choice("render_mode", render_mode, ("rgb_array", "None"))
        self.render_mode = render_mode
        self.options = ThreeGatesOptions(**options)
        self.task = self.options.task
        self.task_description = INSTRUCTION
        self.world = ThreeGatesWorld()
        self._met_wall = False
        self._images = Images(self.world.model, self.options)
        self.action_space = spaces.Box(-LIMIT, LIMIT, (2,), np.float32)
        vectors = ("agent_pos", "agent_vel") if self.options.agent_vel else ("agent_pos",)
        self.observation_space = observation_space(self.options, dict.fromkeys(vectors, 2), 6)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start an episode at a random place near the middle."""
        super().reset(seed=seed)
        distance = START_RADIUS * np.sqrt(self.np_random.random())
        angle = 2 * np.pi * self.np_random.random()
        self.world.reset(distance * np.array([np.cos(angle), np.sin(angle)]))
        self._met_wall = False
        return self._observe(), self._info()

    def step(self, action: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Advance 0.1 s towards the target ``action`` (2,).

        Raises:
            FeatureError: an action of the wrong shape or not finite.
        """
        self.world.step(action)
        self._met_wall |= self.world.touches_wall()
        info = self._info()
        return self._observe(), float(info["is_success"]), info["is_success"], False, info

    @property
    def failure(self) -> str | None:
        """How far this episode got, one of ``FAILURES``; None once it has succeeded."""
        position = self.world.qpos()
        if gate_of(position) >= 0:
            return None
        inside, met_wall, in_a_gate = FAILURES
        if np.hypot(*position) > IN_A_GATE:
            return in_a_gate
        return met_wall if self._met_wall else inside

    def render(self) -> np.ndarray | None:
        """The view from above at visualization size, uint8 (height, width, 3); None without a render mode."""
        if self.render_mode is None:
            return None
        size = self.options.visualization_height, self.options.visualization_width
        return self._images.render(self.world.data, CAMERA, *size)

    def close(self) -> None:
        """Free the OpenGL context, if one was ever opened."""
        self._images.close()

    def _info(self) -> dict[str, Any]:
        mode = gate_of(self.world.qpos())
        return {"is_success": mode >= 0, "mode": mode}

    def _observe(self) -> dict[str, Any]:
        observation: dict[str, Any] = {}
        if self.options.obs_type != "pixels":
            observation["agent_pos"] = self.world.qpos()
        if self.options.agent_vel:
            observation["agent_vel"] = self.world.qvel()
        if self.options.obs_type == "state":
            observation["environment_state"] = self.world.gates()
        else:
            size = self.options.observation_height, self.options.observation_width
            observation["pixels"] = {
                camera: self._images.render(self.world.data, camera, *size) for camera in self.options.cameras
            }
        return observation
