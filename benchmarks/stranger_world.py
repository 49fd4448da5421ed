"""A world and a demonstrator that are not ours: the SO-101 of the plug-in `lerobot_env_so101`, for LeRobot.

The arm is told by how much its hand moves, ten times a second. The plug-in's own controller demonstrates; it
stands still for a second to grasp and for 0.8 s to let go. `pip install lerobot_env_so101==0.4.0`.
"""

from dataclasses import dataclass, field
from itertools import count, islice
from pathlib import Path

import gymnasium as gym
from lerobot.envs.configs import EnvConfig
from world_recording import StateWorldConfig, state_features, write_demonstrations

from lerobot_act_chunking.errors import need

__path__ = []  # LeRobot's --env.discover_packages_path takes every module for a package
PLUGIN = "lerobot_env_so101"
REQUIREMENT = f"{PLUGIN}==0.4.0"
FPS, LIMIT, SCALE = 10, 120, 0.02
SIZES = {"action": 4, "observation.state": 14, "observation.environment_state": 6}


def make(**options):
    """The plug-in's task of picking a block and placing it, both at places that differ."""
    plugin = need(PLUGIN, "the stranger's world", REQUIREMENT)
    return Told(plugin.SO101PickPlaceGymEnv(random_block_position=True, action_scale=SCALE, **options))


class Told(gym.Wrapper):
    """Says ``is_success``, as LeRobot asks; the plug-in says ``succeed``."""

    task = task_description = "place the block"

    def step(self, action):
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, reward, terminated, truncated, {**info, "is_success": bool(info["succeed"])}


def demonstrate(env, seed: int):
    """The controller's episode: observations (T, ...) and actions (T, 4), and whether it succeeds."""
    observation, _ = env.reset(seed=seed)
    scripted = need(f"{PLUGIN}.scripted", "the stranger's controller", REQUIREMENT)
    inner, controller = env.unwrapped, scripted.PickPlaceController(SCALE)
    rows, success = [], False
    for _ in range(LIMIT):
        goal = inner.goal_pos
        block = observation["environment_state"][:3]
        action = controller.act(inner.ik_point_pos, block, goal)
        rows.append((action, observation["agent_pos"], observation["environment_state"]))
        observation, _, terminated, _, info = env.step(action)
        success = info["is_success"]
        if terminated:
            break
    return rows, success


def record(folder: Path, episodes: int) -> None:
    """Demonstrations as a LeRobotDataset, unless they are there."""
    if (folder / "meta" / "info.json").exists():
        return
    env = make()
    attempts = (demonstrate(env, seed) for seed in count())
    shown = islice(((Told.task, rows) for rows, success in attempts if success), episodes)
    names = {key: [f"{number}" for number in range(size)] for key, size in SIZES.items()}
    write_demonstrations(folder, FPS, names, shown)


@dataclass
class StrangerConfig(StateWorldConfig):
    """The world for LeRobot."""

    task: str | None = "Stranger-v0"
    fps: int = FPS
    features: dict = field(default_factory=lambda: state_features(4, 14, 6))

    @property
    def gym_kwargs(self) -> dict:
        return {"max_episode_steps": LIMIT}


if "stranger" not in EnvConfig.get_known_choices():  # loaded a second time as a script
    EnvConfig.register_subclass("stranger")(StrangerConfig)
    gym.register("gym_stranger/Stranger-v0", "stranger_world:make")
