"""From a task and its objects to joint targets for a whole episode."""

from collections.abc import Callable
from typing import cast

import numpy as np

from lerobot_act_chunking.envs.experts import insertion, kinematics, transfer_cube
from lerobot_act_chunking.envs.experts.motion import (
    ArmScript,
    Script,
    blend,
    correlated_noise,
    script_times,
    shift_free,
)
from lerobot_act_chunking.envs.experts.options import ExpertOptions, ExpertPlan
from lerobot_act_chunking.errors import ConfigurationError, unknown_choice

_SCRIPTS: dict[str, tuple[int, Callable[[np.ndarray], Script]]] = {
    "transfer_cube": (7, transfer_cube.script),
    "insertion": (14, insertion.script),
}
_HOME_GRIPPER = (0.0998,)  # gym-aloha starts with fingers all but closed
_ARM_JOINTS = [*range(6), *range(7, 13)]


def plan(task: str, object_pose: np.ndarray, options: ExpertOptions, rng: np.random.Generator) -> ExpertPlan:
    """Plan one episode.

    Args:
        task: one of ``TASKS``.
        object_pose: (7,) or (14,), x y z [m] and quaternion qw qx qy qz per object, upright as gym-aloha
            places them.
        options: pace, noise and pauses.
        rng: source of the noise; a noise-free plan draws nothing from it.

    Returns:
        The joint targets, 50 per second. Without noise they are a smooth function of ``object_pose``.

    Raises:
        ConfigurationError: unknown task, a pose of the wrong shape, or an object out of reach.
    """
    if task not in _SCRIPTS:
        raise unknown_choice("task", task, _SCRIPTS)
    pose_size, write = _SCRIPTS[task]
    script = write(_checked(task, object_pose, pose_size))
    times = script_times(script.duration, script.pauses, options.speed, options.dwell)
    arms = [
        _targets(cast(kinematics.Arm, arm), getattr(script, arm), times, options, rng)
        for arm in ("left", "right")
    ]
    actions = np.concatenate(arms, axis=1)
    return ExpertPlan(actions, _disturbed(actions, options.action_noise, rng))


def _targets(
    arm: kinematics.Arm,
    script: ArmScript,
    times: np.ndarray,
    options: ExpertOptions,
    rng: np.random.Generator,
) -> np.ndarray:
    strokes = script.tool
    if options.waypoint_noise > 0:
        strokes = shift_free(strokes, options.waypoint_noise, rng)
    home = kinematics.forward(arm, np.array(kinematics.HOME_JOINTS))
    joints = kinematics.inverse(arm, blend(times, home.tolist(), strokes))
    return np.concatenate([joints, blend(times, _HOME_GRIPPER, script.gripper)], axis=1)


def _disturbed(actions: np.ndarray, scale: float, rng: np.random.Generator) -> np.ndarray:
    commands = actions.copy()
    if scale > 0:
        commands[:, _ARM_JOINTS] += correlated_noise((len(actions), len(_ARM_JOINTS)), scale, rng)
    return commands


def _checked(task: str, object_pose: np.ndarray, size: int) -> np.ndarray:
    pose = np.asarray(object_pose, dtype=np.float64)
    if pose.shape != (size,) or not np.isfinite(pose).all():
        raise ConfigurationError(
            f"the object pose of {task} is {size} finite numbers, x y z qw qx qy qz per object; "
            f"got shape {pose.shape}: {pose.tolist()}"
        )
    return pose
