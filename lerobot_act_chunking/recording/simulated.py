"""Episodes of a scripted expert in a simulation: what every world of this package has in common."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np

from lerobot_act_chunking.envs.demonstration import ExpertOptions, Ranges
from lerobot_act_chunking.envs.operators import get_operator
from lerobot_act_chunking.envs.options import ObservationOptions
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.recording.episode import DatasetFormat, Episode
from lerobot_act_chunking.recording.lossless import LosslessEncoder
from lerobot_act_chunking.recording.shares import ModeShares
from lerobot_act_chunking.recording.summary import operator_of

# The environments' observations, named and ordered as LeRobot's preprocessing names them in evaluation.
_FEATURES = {
    "agent_pos": "observation.state",
    "agent_vel": "observation.agent_vel",
    "environment_state": "observation.environment_state",
}
_MOST_STEPS = 10_000  # drawn at once, whatever an episode's length, so that no length moves another draw
_DISTRIBUTIONS = ("lerobot_policy_act_chunking", "lerobot", "mujoco", "numpy")


@dataclass(frozen=True)
class World:
    """What a dataset says of a world: its rate [Hz], instruction, robot, and the names of its numbers.

    Attributes:
        fps: control steps a second.
        instruction: the task in words.
        robot_type: LeRobot's free name for the robot.
        actions: a name for each number of an action.
        vectors: the observed vectors with a name for each of their numbers.
        modes: in how many equally valid ways the task is done; ``info["mode"]`` says which, of several.
    """

    fps: int
    instruction: str
    robot_type: str
    actions: tuple[str, ...]
    vectors: Mapping[str, tuple[str, ...]]
    modes: int = 1


@dataclass(frozen=True)
class Step:
    """One control step: what was observed, the clean action for it, and the info of what followed.

    The instruction is the episode's own, where the world's is not that of all of them.
    """

    observation: dict[str, Any]
    action: np.ndarray
    info: dict[str, Any]
    instruction: str | None = None


@dataclass(frozen=True)
class SimulatedSource(ABC):
    """Episodes of a scripted expert; a world adds its simulation and its expert.

    Raises:
        ConfigurationError: what this world's expert cannot do.
    """

    environment: ObservationOptions
    expert: ExpertOptions = field(default_factory=ExpertOptions)
    operators: tuple[str, ...] = ()
    """Who demonstrates in turn, in place of ``expert``."""
    mode_shares: tuple[float, ...] = ()
    """Percentages of the episodes that go each of the task's ways; equal where none are given."""

    ranges: ClassVar[Ranges] = {}
    """What this world's expert can do."""
    env_type: ClassVar[str]
    """LeRobot's ``--env.type`` for this world."""
    distributions: ClassVar[tuple[str, ...]]
    """Further packages that the episodes depend on."""

    def __post_init__(self) -> None:
        self.expert.check(self.ranges)
        if self.operators and self.expert != ExpertOptions():
            raise ConfigurationError(
                f"operators {', '.join(self.operators)} have habits of their own: leave out the expert's "
                f"options ({self.expert.settings()}), or the operators"
            )
        for name in self.operators:
            get_operator(name)
        if self.operators and not self.ranges:
            raise ConfigurationError(
                f"operators {', '.join(self.operators)} need an expert that says what it bears: give "
                f"{type(self).__name__} its `ranges`, or leave out the operators"
            )
        _ = self.shares

    @property
    @abstractmethod
    def world(self) -> World:
        """What the dataset says of the world."""

    @abstractmethod
    def make_env(self) -> gym.Env:
        """The environment, which renders nothing but what is observed."""

    @abstractmethod
    def steps(self, env: Any, seed: int) -> Iterator[Step]:
        """Demonstrate the episode of ``seed`` as ``options_of(seed)`` say, going ``mode_of(seed)``'s way."""

    @property
    def format(self) -> DatasetFormat:
        """Vectors and cameras as LeRobot features."""
        world = self.world
        features = {_FEATURES[name]: _numbers(names) for name, names in world.vectors.items()}
        for camera in self._cameras():
            features[f"observation.images.{camera}"] = {
                "dtype": "video",
                "shape": (self.environment.observation_height, self.environment.observation_width, 3),
                "names": ["height", "width", "channels"],
            }
        features["action"] = _numbers(world.actions)
        return DatasetFormat(world.fps, world.instruction, world.robot_type, features)

    @property
    def settings(self) -> dict[str, Any]:
        """Task, observations, success rule and expert."""
        environment = asdict(self.environment)
        unused = {"visualization_height", "visualization_width"}
        if not self._cameras():
            unused |= {"cameras", "observation_height", "observation_width", "render_quality"}
        kept = {name: value for name, value in environment.items() if name not in unused}
        settings = {"source": f"{self.env_type} expert", **kept}
        if self.world.modes > 1:
            settings["mode_shares"] = list(self.shares.percentages)
        if self.operators:
            return {**settings, "operators": {name: asdict(get_operator(name)) for name in self.operators}}
        return {**settings, "expert": self.expert.settings()}

    @property
    def shares(self) -> ModeShares:
        """How often each way of doing the task is shown."""
        return ModeShares.of_task(self.world.modes, self.mode_shares)

    def mode_of(self, seed: int) -> int:
        """Which way the episode of ``seed`` goes."""
        return self.shares.mode_of(seed)

    def operator_of(self, seed: int) -> str | None:
        """Who demonstrates the episode of ``seed``; None if nobody in particular."""
        return operator_of(self.operators, seed) if self.operators else None

    def options_of(self, seed: int) -> ExpertOptions:
        """How the episode of ``seed`` is demonstrated."""
        operator = self.operator_of(seed)
        if operator is None:
            return self.expert
        return get_operator(operator).episode(_stream(seed, 2), self.ranges)

    @property
    def versions(self) -> dict[str, str]:
        """Versions of the simulator, the models and this package."""
        return {name: version(name) for name in (*_DISTRIBUTIONS, *self.distributions)}

    @contextmanager
    def open(self) -> Iterator[Callable[[int], Episode]]:
        """Build the environment; its renderer is freed on leaving."""
        with closing(self.make_env()) as env:
            yield lambda seed: self.play(env, seed)

    def play(self, env: Any, seed: int) -> Episode:
        """The episode of ``seed`` in an environment of ``make_env``."""
        vectors: dict[str, list[np.ndarray]] = {name: [] for name in self.world.vectors}
        size = self.environment.observation_height, self.environment.observation_width
        cameras = {camera: LosslessEncoder(*size) for camera in self._cameras()}
        actions, info, instruction = [], {}, None
        options = self.options_of(seed)
        missed = _stream(seed, 3).random(_MOST_STEPS) < options.dropped_frames
        for index, step in enumerate(self.steps(env, seed)):
            info, instruction = step.info, step.instruction
            if missed[index % _MOST_STEPS] and index:
                continue
            for name, rows in vectors.items():
                rows.append(step.observation[name])
            for camera, encoder in cameras.items():
                encoder.append(step.observation["pixels"][camera])
            actions.append(step.action)
        arrays = {_FEATURES[name]: np.asarray(rows, np.float32) for name, rows in vectors.items()}
        planted = {"mode": self.mode_of(seed)} if self.world.modes > 1 else {}
        return Episode(
            seed=seed,
            success=info["is_success"] and all(info[name] == way for name, way in planted.items()),
            arrays={**arrays, "action": np.asarray(actions, np.float32)},
            videos={f"observation.images.{camera}": encoder.finish() for camera, encoder in cameras.items()},
            details={
                **{name: met for name, met in info.items() if name.startswith("success_")},
                **({"operator": self.operator_of(seed)} if self.operators else {}),
                **planted,
                "expert": options.settings(),
            },
            task=None if instruction == self.world.instruction else instruction,
        )

    def _cameras(self) -> list[str]:
        return [] if self.environment.obs_type == "state" else self.environment.cameras


def noise_stream(seed: int) -> np.random.Generator:
    """The expert's random numbers; the environment draws its own from the plain ``seed``."""
    return _stream(seed, 1)


def _stream(seed: int, purpose: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(purpose,)))


def _numbers(names: tuple[str, ...]) -> dict[str, Any]:
    return {"dtype": "float32", "shape": (len(names),), "names": list(names)}
