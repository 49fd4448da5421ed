"""Somebody else's environment: of no class of this package, and known to it by LeRobot's registry alone."""

from dataclasses import dataclass, field

import gymnasium as gym
import numpy as np
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.processor import ObservationProcessorStep, PolicyActionProcessorStep, PolicyProcessorPipeline

__path__ = []  # LeRobot's --env.discover_packages_path takes every module for a package
STEPS = 12


class Line(gym.Env):
    """A point that commands move; success, under ``key``, is to be past ``end``. It cannot be drawn."""

    action_space = gym.spaces.Box(-1, 1, (2,), np.float32)
    metadata = {"render_modes": [], "render_fps": 10}  # noqa: RUF012  (Gymnasium declares it so)
    task = task_description = "go on"

    def __init__(self, width=2, end=0.2, key="is_success"):
        self.observation_space = gym.spaces.Dict({"agent_pos": gym.spaces.Box(-9, 9, (width,), np.float64)})
        self.width, self.end, self.key = width, end, key

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.position = self.np_random.uniform(-0.1, 0.1, self.width)
        return {"agent_pos": self.position}, {}

    def step(self, action):
        self.position = self.position.copy()
        self.position[:2] += 0.1 * action
        done = bool(self.position[0] > self.end)
        return (
            {"agent_pos": self.position},
            float(self.position[0]),
            done,
            False,
            {self.key: done} if self.key else {},
        )


class Doubled(ObservationProcessorStep):
    def observation(self, observation):
        return {**observation, "observation.state": 2 * observation["observation.state"]}

    def transform_features(self, features):
        return features


class DoubledAction(PolicyActionProcessorStep):
    def action(self, action):
        return 2 * action

    def transform_features(self, features):
        return features


@dataclass
class Ends:
    """Where the line ends."""

    success: float = 0.2


@EnvConfig.register_subclass("line_of_tests")
@dataclass
class LineConfig(EnvConfig):
    task: str | None = "Line-v0"
    fps: int = 10
    features: dict = field(default_factory=dict)
    features_map: dict = field(
        default_factory=lambda: {"action": "action", "agent_pos": "observation.state"},
    )
    width: int = 2
    ends: Ends = field(default_factory=Ends)
    doubled: bool = False
    n_tasks: int = 1
    limited: bool = True
    key: str = "is_success"

    def __post_init__(self):
        if self.width < 2:
            raise ValueError(f"a line of width {self.width}")
        self.features = {
            "action": PolicyFeature(FeatureType.ACTION, (2,)),
            "agent_pos": PolicyFeature(FeatureType.STATE, (self.width,)),
        }

    @property
    def gym_kwargs(self):
        limit = {"max_episode_steps": STEPS} if self.limited else {}
        return {"width": self.width, "end": self.ends.success, "key": self.key, **limit}

    def create_envs(self, n_envs, use_async_envs=False):
        (suite,) = super().create_envs(n_envs, use_async_envs).values()
        return {"line": dict.fromkeys(range(self.n_tasks), suite[0])}

    def get_env_processors(self):
        before, after = ([Doubled()], [DoubledAction()]) if self.doubled else ([], [])
        return PolicyProcessorPipeline(steps=before), PolicyProcessorPipeline(steps=after)


gym.register("gym_line_of_tests/Line-v0", Line)
