"""The ALOHA cell's joints and its tasks: which MuJoCo model, where objects start, what gym-aloha rewards."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, cast

import numpy as np

from lerobot_act_chunking.envs.aloha import rewards
from lerobot_act_chunking.envs.aloha.instructions import COLOURS
from lerobot_act_chunking.errors import ConfigurationError, unknown_choice

_ARM_JOINTS = ("waist", "shoulder", "elbow", "forearm_roll", "wrist_angle", "wrist_rotate", "gripper")
JOINT_NAMES: tuple[str, ...] = tuple(
    f"{side}_arm_{joint}" for side in ("left", "right") for joint in _ARM_JOINTS
)
"""Names of the 14 actions and joint positions. Arm joints are in rad, grippers 0 (closed) to 1 (open)."""

_UPRIGHT = (1.0, 0.0, 0.0, 0.0)
_MAX_SEED = 2**32 - 1


@dataclass(frozen=True)
class Task:
    """One task: its MJCF file in gym-aloha, its instruction, its objects' start boxes and its reward."""

    mjcf: str
    instruction: str
    start_boxes: tuple[tuple[tuple[float, float, float], tuple[float, float, float]], ...]
    """One (low xyz, high xyz) box [m] per object, in the order of the model's free joints."""
    reward: Callable[..., int]  # of the touching geoms, and of the goal where there are several cubes
    cubes: tuple[str, ...] = ()
    """Colours of the cubes, where there are several."""
    hand_overs: tuple[tuple[float, float, float], ...] = ()
    """Where the cube changes hands [m], one place for each of several equally valid ways; none: anywhere."""

    @property
    def modes(self) -> int:
        """How many ways of doing the task are told apart."""
        return max(1, len(self.hand_overs))

    @property
    def pose_size(self) -> int:
        """Length of the object pose: x y z qw qx qy qz per object."""
        return 7 * len(self.start_boxes)


_TRANSFER_CUBE = Task(
    mjcf="bimanual_viperx_transfer_cube.xml",
    instruction="Pick up the cube with the right arm and transfer it to the left arm.",
    start_boxes=(((0.0, 0.4, 0.05), (0.2, 0.6, 0.05)),),
    reward=rewards.transfer_cube,
)
_TASKS = {
    "transfer_cube": _TRANSFER_CUBE,
    "insertion": Task(
        mjcf="bimanual_viperx_insertion.xml",
        instruction="Insert the peg into the socket.",
        start_boxes=(((0.1, 0.4, 0.05), (0.2, 0.6, 0.05)), ((-0.2, 0.4, 0.05), (-0.1, 0.6, 0.05))),
        reward=rewards.insertion,
    ),
    # Low on the left, low on the right, high between: equally far apart, so that none is a mean of others.
    "transfer_modes": replace(
        _TRANSFER_CUBE, hand_overs=((-0.085, 0.5, 0.23), (0.085, 0.5, 0.23), (0.0, 0.5, 0.377))
    ),
    # In the middle, where both arms reach, and far enough apart for a gripper between them.
    "language_transfer": replace(
        _TRANSFER_CUBE,
        instruction="Hand the named cube to the named arm.",
        start_boxes=tuple(((-0.04, y - 0.02, 0.05), (0.04, y + 0.02, 0.05)) for y in (0.37, 0.5, 0.63)),
        cubes=COLOURS,
    ),
}

TASKS: tuple[str, ...] = tuple(_TASKS)


def get_task(name: str) -> Task:
    """The task called ``name``.

    Raises:
        ConfigurationError: no such task.
    """
    if name not in _TASKS:
        raise unknown_choice("task", name, TASKS)
    return _TASKS[name]


def mjcf_path(task: str) -> Path:
    """Path of the task's MJCF in the installed gym-aloha, found without importing it (that pulls dm_control).

    Raises:
        ConfigurationError: unknown task, or gym-aloha is not installed.
    """
    spec = find_spec("gym_aloha")
    if spec is None or not spec.submodule_search_locations:
        raise ConfigurationError("the ALOHA models are missing: pip install gym-aloha")
    return Path(spec.submodule_search_locations[0]) / "assets" / get_task(task).mjcf


def sample_object_pose(task: str, rng: np.random.Generator) -> np.ndarray:
    """Draw the objects' start poses, uniform over gym-aloha's ranges.

    Returns:
        (7,) for transfer_cube, (14,) for insertion, (21,) for language_transfer: x y z [m] and quaternion
        qw qx qy qz per object.

    Raises:
        ConfigurationError: unknown task.
    """
    boxes = get_task(task).start_boxes
    return np.concatenate([np.concatenate([rng.uniform(low, high), _UPRIGHT]) for low, high in boxes])


def stock_generator(seed: int) -> np.random.Generator:
    """The generator whose first pose from ``sample_object_pose`` is the one gym-aloha draws for ``seed``.

    gym-aloha draws from the legacy ``RandomState(seed)``; the same Mersenne Twister state behind the modern
    ``Generator`` gives the same uniforms, so results compare episode by episode.

    Raises:
        ConfigurationError: the seed is outside the legacy range 0 .. 2**32 - 1.
    """
    if not 0 <= seed <= _MAX_SEED:
        raise ConfigurationError(f"seed {seed} is outside gym-aloha's range 0 .. {_MAX_SEED}")
    bit_generator = np.random.MT19937()
    bit_generator.state = cast(Any, np.random.RandomState(seed).get_state(legacy=False))
    return np.random.Generator(bit_generator)
