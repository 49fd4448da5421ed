"""The SO-101's joints, and its tasks: which objects there are and where they start."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from lerobot_act_chunking.errors import unknown_choice

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
"""The motors, in LeRobot's order."""
ARM_JOINTS = JOINTS[:-1]
NAMES = tuple(f"{joint}.pos" for joint in JOINTS)
"""Names of the numbers of an action and of ``observation.state``: joints in degrees from the middle of their
range, the gripper from 0 (closed) to 100 (open), as LeRobot's ``so101_follower`` has them by default."""

CUBE_SIZE = 0.028
"""Side of a cube [m]."""
BOX_INSIDE = 0.075
"""Inner side of a box [m]."""

SUCCESS_RULES = ("placed", "released")
"""The cube is in its place; or it rests there, and nothing holds it."""

Place = tuple[float, float]
Area = tuple[Place, Place]


@dataclass(frozen=True)
class Task:
    """One task: its instruction, its objects, and the area [m] in which each of them starts.

    Attributes:
        instruction: in words.
        cubes: where cubes start, by name: lowest and highest (x, y).
        boxes: the same of the boxes.
        modes: how many ways of doing the task are told apart.
    """

    instruction: str
    cubes: Mapping[str, Area]
    boxes: Mapping[str, Area] = field(default_factory=dict)
    modes: int = 1

    @property
    def goals(self) -> tuple[str, ...]:
        """Where the cube may go: a box, or the other cube."""
        return tuple(self.boxes) or tuple(name for name in self.cubes if name != "cube")

    @property
    def environment_names(self) -> tuple[str, ...]:
        """A name for each number of ``environment_state``: poses of the cubes, places of the boxes."""
        poses = [
            f"{cube}_{entry}" for cube in self.cubes for entry in ("x", "y", "z", "qw", "qx", "qy", "qz")
        ]
        return *poses, *(f"{box}_{axis}" for box in self.boxes for axis in "xy")


_TASKS = {
    "pick_place": Task(
        "Put the cube into the box.",
        {"cube": ((0.19, -0.13), (0.27, 0.01))},
        {"box": ((0.185, 0.12), (0.215, 0.15))},
    ),
    "stack": Task(
        "Put the red cube on the green cube.",
        {"cube": ((0.19, -0.13), (0.27, -0.02)), "green_cube": ((0.19, 0.05), (0.25, 0.12))},
    ),
    # As far to the left as to the right, so that no way is nearer or shorter than the other.
    "two_ways": Task(
        "Put the cube into either box.",
        {"cube": ((0.21, -0.03), (0.28, 0.03))},
        {"left_box": ((0.165, 0.135), (0.185, 0.155)), "right_box": ((0.165, -0.155), (0.185, -0.135))},
        modes=2,
    ),
}
TASKS: tuple[str, ...] = tuple(_TASKS)
_TURN = np.deg2rad(30.0)  # to either side: how far a cube is turned


def get_task(name: str) -> Task:
    """The task called ``name``.

    Raises:
        ConfigurationError: no such task.
    """
    if name not in _TASKS:
        raise unknown_choice("task", name, TASKS)
    return _TASKS[name]


def sample_places(task: Task, rng: np.random.Generator) -> np.ndarray:
    """Where the objects start: ``environment_state`` (E,), cubes flat and turned by up to 30 degrees."""
    numbers: list[float] = []
    for low, high in task.cubes.values():
        turn = rng.uniform(-_TURN, _TURN)
        numbers += [*rng.uniform(low, high), CUBE_SIZE / 2, np.cos(turn / 2), 0.0, 0.0, np.sin(turn / 2)]
    for low, high in task.boxes.values():
        numbers += [*rng.uniform(low, high)]
    return np.array(numbers)
