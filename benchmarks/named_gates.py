"""The three gates with an instruction that names one: the smallest world in which words decide.

Instructions are made of a sentence and a word for the gate. Demonstrations use the `SEEN` ones; the others
tell whether a policy has learned words or sentences by heart.

`python benchmarks/named_gates.py data/named_gates` records the demonstrations.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import gymnasium as gym
import numpy as np
from lerobot.envs.configs import EnvConfig
from world_recording import StateWorldConfig, state_features, write_demonstrations

from lerobot_act_chunking.envs.demonstration import ExpertOptions
from lerobot_act_chunking.envs.three_gates.env import ThreeGatesEnv
from lerobot_act_chunking.envs.three_gates.expert import plan
from lerobot_act_chunking.envs.three_gates.world import FPS
from lerobot_act_chunking.recording.simulated import noise_stream

__path__ = []  # LeRobot's --env.discover_packages_path takes every module for a package
LIMIT, EPISODES = 40, 70
SEEN = ("leave through the {} gate", "go out by the {} gate", "take the {} gate", "the {} gate is yours")
UNSEEN = ("exit via the {} opening", "please use the {} way out", "move out through the door that is {}")
WORDS = (("top", "upper", "high"), ("left", "left hand"), ("right", "right hand"))
NEW_WORDS = (("topmost", "highest", "uppermost"), ("leftmost", "far left"), ("rightmost", "far right"))
PHRASES = {
    "seen": (SEEN, WORDS),
    "sentences": (UNSEEN, WORDS),
    "words": (SEEN, NEW_WORDS),
    "shuffled": (SEEN, WORDS),  # of a gate that is drawn anew: nobody can do better than chance
}


class NamedGates(ThreeGatesEnv):
    """Success is to leave through the gate that is named.

    Args:
        instructions: whose sentences and words, a name of `PHRASES`.
    """

    def __init__(self, instructions: str = "seen") -> None:
        super().__init__(render_mode=None)
        self.instructions = instructions

    def reset(self, *, seed=None, options=None):
        observation, info = super().reset(seed=seed)
        self.name(int(self.np_random.integers(3)))
        return observation, {**info, "is_success": False}

    def name(self, goal: int) -> None:
        """Ask for this gate, in words that are drawn."""
        sentences, words = PHRASES[self.instructions]
        told = int(self.np_random.integers(3)) if self.instructions == "shuffled" else goal
        self.goal = goal
        sentence, word = self.np_random.choice(sentences), self.np_random.choice(words[told])
        self.task_description = str(sentence).format(word)

    def step(self, action):
        observation, _, over, truncated, info = super().step(action)
        success = info["mode"] == self.goal
        return observation, float(success), over, truncated, {**info, "is_success": success}

    @property
    def failure(self) -> str | None:
        return super().failure or "another gate"


def demonstrations(episodes: int) -> Iterator[tuple[str, list[tuple[np.ndarray, ...]]]]:
    """Instructions, and the actions, positions and gates of each episode; the gates take turns."""
    env, options = NamedGates(), ExpertOptions(waypoint_noise=0.03, hand_noise=0.005, action_noise=0.01)
    for seed in range(episodes):
        observation, _ = env.reset(seed=seed)
        env.name(seed % 3)
        rows = []
        plans = plan(env.world.qpos(), options, noise_stream(seed), mode=env.goal)
        for action, command in zip(*plans, strict=True):
            rows.append((action, observation["agent_pos"], observation["environment_state"]))
            observation, *_, info = env.step(command)
        if not info["is_success"]:
            raise RuntimeError(f"the expert fails at seed {seed}")
        yield env.task_description, rows


def record(folder: Path, episodes: int = EPISODES) -> None:
    """Demonstrations as a LeRobotDataset, unless they are there."""
    if not (folder / "meta" / "info.json").exists():
        names = {
            "action": ["x", "y"],
            "observation.state": ["x", "y"],
            "observation.environment_state": [f"gate_{gate}_{axis}" for gate in range(3) for axis in "xy"],
        }
        write_demonstrations(folder, FPS, names, demonstrations(episodes))


@dataclass
class NamedGatesConfig(StateWorldConfig):
    """The world for LeRobot."""

    task: str | None = "NamedGates-v0"
    fps: int = FPS
    instructions: str = "seen"
    features: dict = field(default_factory=lambda: state_features(2, 2, 6))

    @property
    def gym_kwargs(self) -> dict:
        return {"max_episode_steps": LIMIT, "instructions": self.instructions}


if "named_gates" not in EnvConfig.get_known_choices():  # loaded a second time as a script
    EnvConfig.register_subclass("named_gates")(NamedGatesConfig)
    gym.register("gym_named_gates/NamedGates-v0", "named_gates:NamedGates")

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    record(parser.parse_args().folder)
