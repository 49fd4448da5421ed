"""The ALOHA simulation as a Gymnasium environment."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from lerobot_act_chunking.envs.aloha.failures import make_progress
from lerobot_act_chunking.envs.aloha.instructions import Goal, draw_goal, draw_phrase
from lerobot_act_chunking.envs.aloha.modes import HandOverMode
from lerobot_act_chunking.envs.aloha.options import AlohaSimOptions
from lerobot_act_chunking.envs.aloha.success import SUCCESS_RULES, make_reward, make_success_rule
from lerobot_act_chunking.envs.aloha.tasks import JOINT_NAMES, get_task, sample_object_pose, stock_generator
from lerobot_act_chunking.envs.aloha.world import AlohaWorld
from lerobot_act_chunking.envs.rendering import Images
from lerobot_act_chunking.envs.spaces import observation_space
from lerobot_act_chunking.errors import unknown_choice

# gym-aloha's bounds; joints overshoot their soft limits, and an object that leaves the table falls for ever.
_WIDE = 1000.0


class AlohaSimEnv(gym.Env):
    """Bimanual ALOHA, 50 Hz: gym-aloha's physics, actions and rewards; observations on request.

    Observations: ``agent_pos`` (14,) and ``agent_vel`` (14,) in the order of ``JOINT_NAMES``;
    ``environment_state`` (7,), (14,) or (21,), x y z qw qx qy qz per object; ``pixels``
    {camera: uint8 (height, width, 3)}.

    Actions: (14,) joint targets [rad] and grippers 0 (closed) to 1 (open). ``action_space`` spans the
    actuators' range, to which MuJoCo clips (gym-aloha declares -1 .. 1, which its own radians leave).

    Info: ``success_touch`` and ``success_hold``, each true from the step on at which its rule was satisfied,
    and ``is_success``, the one chosen by ``success``. The episode terminates when it becomes true. Of a task
    with several ways also ``mode``: which way this episode went (`HandOverMode`), -1 before that is decided
    and where it is none of them.

    Failure: ``failure``, one of ``FAILURES``, or None once the episode has succeeded.

    Seeds: ``reset(seed=s)`` starts the very episode gym-aloha starts for seed ``s``, so results compare
    episode by episode; resets without a seed draw from ``np_random``; with
    ``reset(options={"object_pose": array})`` the caller places the objects, with ``{"goal": Goal(...)}`` it
    chooses what language_transfer is about.

    Instruction: ``task_description``, where LeRobot looks for it. In language_transfer each episode has its
    own, which alone tells what counts: the ``goal``.

    Args:
        render_mode: "rgb_array" or None.
        options: fields of ``AlohaSimOptions``.

    Raises:
        ConfigurationError: an option that cannot work.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 50}  # noqa: RUF012  (Gymnasium declares it so)

    def __init__(self, render_mode: str | None = "rgb_array", **options: Any) -> None:
        if render_mode not in (None, "rgb_array"):
            raise unknown_choice("render_mode", render_mode, ("rgb_array", "None"))
        self.render_mode = render_mode
        self.options = AlohaSimOptions(**options)
        self.task = self.options.task
        self.task_description = get_task(self.task).instruction
        self.goal = Goal()
        self.world = AlohaWorld(self.task)
        places = get_task(self.task).hand_overs
        self._mode = HandOverMode(places) if places else None
        self._begin()
        self._images = Images(self.world.model, self.options)
        self.action_space = self._action_space()
        vectors = ("agent_pos", "agent_vel") if self.options.agent_vel else ("agent_pos",)
        sizes: dict[str, int] = dict.fromkeys(vectors, len(JOINT_NAMES))
        self.observation_space = observation_space(self.options, sizes, get_task(self.task).pose_size, _WIDE)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start an episode; see the class for seeds and ``options["object_pose"]``.

        Raises:
            ConfigurationError: a seed outside gym-aloha's range, or an impossible object pose.
        """
        super().reset(seed=seed)
        rng = self.np_random if seed is None else stock_generator(seed)
        options = options or {}
        pose = options.get("object_pose")
        self.world.reset(sample_object_pose(self.task, rng) if pose is None else pose)
        if get_task(self.task).cubes:
            drawn = draw_goal(rng)
            self.goal = options.get("goal", drawn)
            self.task_description = draw_phrase(self.goal, self.options.instructions, rng)
        self._begin()
        if self._mode is not None:
            self._mode.reset()
        return self._observe(), self._info()

    def _begin(self) -> None:
        self._reward = make_reward(self.task, self.goal)
        self._rules = {name: make_success_rule(name, self.task, self.goal) for name in SUCCESS_RULES}
        self._progress = make_progress(self.task, self.goal)

    def step(self, action: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Advance 20 ms towards the joint targets ``action`` (14,).

        Raises:
            FeatureError: an action of the wrong shape or not finite.
        """
        self.world.step(action)
        contacts = self.world.contacts()
        for rule in self._rules.values():
            rule.update(contacts)
        if self._mode is not None:
            self._mode.update(contacts, self.world.environment_state()[:3])
        self._progress.update(contacts, self.world.heights())
        info = self._info()
        return self._observe(), float(self._reward(contacts)), info["is_success"], False, info

    @property
    def failure(self) -> str | None:
        """How far this episode got, one of the task's ``FAILURES``; None once it has succeeded."""
        return None if self._rules[self.options.success].succeeded else self._progress.failure

    def render(self) -> np.ndarray | None:
        """The ``top`` camera at visualization size, uint8 (height, width, 3); None without a render mode."""
        if self.render_mode is None:
            return None
        size = self.options.visualization_height, self.options.visualization_width
        return self._images.render(self.world.data, "top", *size)

    def close(self) -> None:
        """Free the OpenGL context, if one was ever opened."""
        self._images.close()

    def _info(self) -> dict[str, Any]:
        successes = {f"success_{name}": rule.succeeded for name, rule in self._rules.items()}
        modes = {} if self._mode is None else {"mode": self._mode.mode}
        return {"is_success": self._rules[self.options.success].succeeded, **successes, **modes}

    def _observe(self) -> dict[str, Any]:
        observation: dict[str, Any] = {}
        if self.options.obs_type != "pixels":
            observation["agent_pos"] = self.world.qpos()
        if self.options.agent_vel:
            observation["agent_vel"] = self.world.qvel()
        if self.options.obs_type == "state":
            observation["environment_state"] = self.world.environment_state()
        else:
            size = self.options.observation_height, self.options.observation_width
            observation["pixels"] = {
                camera: self._images.render(self.world.data, camera, *size) for camera in self.options.cameras
            }
        return observation

    def _action_space(self) -> spaces.Box:
        low, high = self.world.action_limits()
        return spaces.Box(low.astype(np.float32), high.astype(np.float32))
