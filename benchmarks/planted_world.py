"""A world for planted faults: a point waits at a post, goes around an obstacle and meets a goal that jumps.

Whoever replans at the post at every step waits for ever, since demonstrators wait there. Whoever reacts late
crosses the line where the goal was. Whoever wavers between the two ways around the obstacle runs into it.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import count, islice
from pathlib import Path

import gymnasium as gym
import numpy as np
from lerobot.envs.configs import EnvConfig
from world_recording import StateWorldConfig, state_features, write_demonstrations

__path__ = []  # LeRobot's --env.discover_packages_path takes every module for a package
FPS, LIMIT = 20, 140
POST, OBSTACLE, RADIUS = np.array([0.0, -0.6]), np.array([0.0, 0.0]), 0.25
REACH, SPEED, ASIDE, WAIT = 0.07, 0.04, 0.03, 5
STARTS, GOALS, JUMPS = (-0.3, 0.3), (-0.3, 0.3), (0.25, 0.45)


class Courier(gym.Env):
    """Actions are positions to go to; success is to cross the line y = 1 at the goal.

    Args:
        unfair: share of the episodes in which the goal is closed, which nobody sees.
        same_side: the goal stays on its side of the obstacle when it jumps.
    """

    action_space = gym.spaces.Box(-2, 2, (2,), np.float32)
    task = task_description = "meet the goal"

    def __init__(self, unfair: float = 0.0, same_side: bool = False) -> None:
        self.unfair, self.same_side = unfair, same_side
        vector = gym.spaces.Box(-9, 9, (2,), np.float64)
        self.observation_space = gym.spaces.Dict({"agent_pos": vector, "environment_state": vector})

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        draw = self.np_random.uniform
        self.position = np.array([draw(*STARTS), -1.0])
        self.goal, self.next = np.array([draw(*GOALS), 1.0]), np.array([draw(*GOALS), 1.0])
        self.jump, self.failure = draw(*JUMPS), None
        if self.same_side:
            self.next[0] = np.copysign(self.next[0], self.goal[0])
        self.closed = draw() < self.unfair
        return self._observe(), {}

    def step(self, action):
        step = np.asarray(action, np.float64) - self.position
        length = np.linalg.norm(step)
        self.position = self.position + step * min(1.0, SPEED / max(length, 1e-9))
        if self.position[1] > self.jump:
            self.goal = self.next
        hit = bool(np.linalg.norm(self.position - OBSTACLE) < RADIUS)
        there = bool(self.position[1] >= 1.0)
        success = there and not self.closed and abs(self.position[0] - self.goal[0]) < REACH
        self.failure = "hit" if hit else "missed" if there and not success else None
        return self._observe(), self.position[1], hit or there, False, {"is_success": bool(success)}

    def _observe(self):
        return {"agent_pos": self.position.copy(), "environment_state": self.goal.copy()}


class Demonstrator:
    """Waits at the post, passes the obstacle on one side, and follows the goal.

    Args:
        rng: of its choices.
        right: probability of the right side.
    """

    def __init__(self, rng: np.random.Generator, right: float) -> None:
        self.side = 1.0 if rng.random() < right else -1.0
        self.waited, self.passed = 0, 0

    def act(self, position: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """The command (2,), a step ahead, at this observation."""
        if self.passed == 0 and np.linalg.norm(position - POST) < 1e-3:
            self.waited += 1
            self.passed = int(self.waited > WAIT)
        if self.passed == 1 and position[1] > -1e-3:
            self.passed = 2
        if self.passed == 2:  # to the side of the goal first, then straight through the line
            aside = float(np.clip(goal[0] - position[0], -ASIDE, ASIDE))
            return position + np.array([aside, (SPEED**2 - aside**2) ** 0.5])
        step = (POST, np.array([0.42 * self.side, 0.0]))[self.passed] - position
        return position + step * min(1.0, SPEED / max(float(np.linalg.norm(step)), 1e-9))


def record(
    folder: Path, episodes: int, *, right: float = 0.0, most_start: float = 9.0, seed: int = 0
) -> None:
    """Demonstrations as a LeRobotDataset, unless they are there.

    Args:
        folder: of the dataset.
        episodes: how many.
        right: probability of passing on the right.
        most_start: leave out episodes that start or have their goal further right than this.
        seed: of the first episode.
    """
    if (folder / "meta" / "info.json").exists():
        return
    keys = ("action", "observation.state", "observation.environment_state")
    shown = islice(_demonstrations(right, most_start, seed), episodes)
    write_demonstrations(folder, FPS, {key: ["x", "y"] for key in keys}, shown)


def _demonstrations(
    right: float, most_start: float, first: int
) -> Iterator[tuple[str, list[tuple[np.ndarray, ...]]]]:
    """The instruction, and actions, positions and goals, of one episode after the other."""
    env = Courier()
    for seed in count(first):
        observation, _ = env.reset(seed=seed)
        demonstrator = Demonstrator(np.random.default_rng(seed), right)
        if max(env.goal[0], env.next[0]) > most_start:
            continue
        rows, over, info = [], False, {"is_success": False}
        while not over:
            seen = observation["agent_pos"], observation["environment_state"]
            action = demonstrator.act(*seen)
            rows.append((action, *seen))
            observation, _, over, _, info = env.step(action)
        if not info["is_success"]:
            raise RuntimeError(f"the demonstrator fails at seed {seed}")
        yield Courier.task, rows


@dataclass
class CourierConfig(StateWorldConfig):
    """The world for LeRobot."""

    task: str | None = "Courier-v0"
    fps: int = FPS
    unfair: float = 0.0
    same_side: bool = False
    features: dict = field(default_factory=lambda: state_features(2, 2, 2))

    @property
    def gym_kwargs(self) -> dict:
        return {"max_episode_steps": LIMIT, "unfair": self.unfair, "same_side": self.same_side}


if "planted_courier" not in EnvConfig.get_known_choices():  # loaded a second time as a script
    EnvConfig.register_subclass("planted_courier")(CourierConfig)
    gym.register("gym_planted_courier/Courier-v0", "planted_world:Courier")
