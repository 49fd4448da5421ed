"""What a task of gymnasium-robotics is: its observation by parts, its goals, its actions, its success."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from lerobot_act_chunking.errors import ConfigurationError


@dataclass(frozen=True)
class Part:
    """Consecutive numbers of an original observation or goal.

    Attributes:
        name: as in the original's documentation.
        size: how many.
        robot: whether they are the robot's own.
        velocity: whether they are velocities.
    """

    name: str
    size: int
    robot: bool = False
    velocity: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """A name for each number: ``grip_pos_0``, ...; the part's own if it is one number."""
        return (self.name,) if self.size == 1 else tuple(f"{self.name}_{i}" for i in range(self.size))


@dataclass(frozen=True)
class RoboticsTask:
    """One environment of gymnasium-robotics, as the original declares it.

    The original's ``observation`` is ``parts`` in a row. Those of the robot become ``agent_pos``, in their
    order; the others, followed by ``goal``, become ``environment_state``. The achieved goal is left out: in
    every task it is among the parts already.
    """

    instruction: str
    parts: tuple[Part, ...]
    actions: tuple[str, ...]
    """A name for each action; all of them range over -1 .. 1."""
    fps: int
    """Control steps a second, as the original declares them."""
    episode_length: int
    """The original's time limit [control steps]."""
    succeeds: Callable[[Mapping[str, Any]], bool]
    """Whether the step that returned this info succeeds."""
    goal: tuple[Part, ...] = ()
    """The desired goal, if there is one; several parts are the members of a goal that is a dictionary."""
    cameras: tuple[str, ...] = ("view",)
    """Cameras to choose from; ``view`` is what the original's ``render()`` shows."""
    velocities: bool = True
    """Whether velocities are observed."""

    def without_velocities(self) -> Self:
        """The task as it is observed where velocities are left out."""
        return replace(self, velocities=False)

    @cached_property
    def state(self) -> dict[str, slice]:
        """Where each robot part is in ``agent_pos``."""
        return _slices(self._robot_parts)

    @cached_property
    def environment(self) -> dict[str, slice]:
        """Where each other part and goal is in ``environment_state``."""
        return _slices(self._other_parts)

    @property
    def state_names(self) -> tuple[str, ...]:
        """A name for each number of ``agent_pos``."""
        return tuple(name for part in self._robot_parts for name in part.names)

    @property
    def environment_names(self) -> tuple[str, ...]:
        """A name for each number of ``environment_state``."""
        return tuple(name for part in self._other_parts for name in part.names)

    @property
    def _robot_parts(self) -> tuple[Part, ...]:
        return tuple(part for part in self.parts if part.robot and self._observes(part))

    @property
    def _other_parts(self) -> tuple[Part, ...]:
        return *(part for part in self.parts if not part.robot and self._observes(part)), *self.goal

    def _observes(self, part: Part) -> bool:
        return self.velocities or not part.velocity

    def _where(self, chosen: Callable[[Part], bool]) -> np.ndarray:
        return np.repeat([chosen(part) for part in self.parts], [part.size for part in self.parts])

    @cached_property
    def _of_robot(self) -> np.ndarray:
        return self._where(lambda part: part.robot and self._observes(part))

    @cached_property
    def _of_others(self) -> np.ndarray:
        return self._where(lambda part: not part.robot and self._observes(part))

    def split(self, observation: Any) -> tuple[np.ndarray, np.ndarray]:
        """``agent_pos`` and ``environment_state``, float64, of an original observation.

        Args:
            observation: an array, or with a goal a dictionary of ``observation`` and ``desired_goal``.

        Raises:
            ConfigurationError: it is not laid out as declared.
        """
        vector = observation["observation"] if self.goal else observation
        if np.shape(vector) != self._of_robot.shape:
            raise ConfigurationError(
                f"this gymnasium-robotics observes {np.shape(vector)}, the declared layout is "
                f"{self._of_robot.shape}: pip install 'gymnasium-robotics>=1.4,<2'"
            )
        goals = [observation["desired_goal"]] if self.goal else []
        if len(self.goal) > 1:
            goals = [observation["desired_goal"][part.name] for part in self.goal]
        return vector[self._of_robot], np.concatenate([vector[self._of_others], *goals])

    def named(self, agent_pos: np.ndarray, environment_state: np.ndarray) -> dict[str, np.ndarray]:
        """Every observed part and goal by its name."""
        return {name: agent_pos[place] for name, place in self.state.items()} | {
            name: environment_state[place] for name, place in self.environment.items()
        }


def _slices(parts: Any) -> dict[str, slice]:
    slices, start = {}, 0
    for part in parts:
        slices[part.name] = slice(start, start + part.size)
        start += part.size
    return slices
