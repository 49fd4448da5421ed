"""From a task and its objects to joint targets for a whole episode."""

from collections.abc import Callable

import numpy as np

from lerobot_act_chunking.envs.aloha.experts import insertion, stepwise, transfer_cube
from lerobot_act_chunking.envs.aloha.experts.kinematics import HOME_JOINTS, Arm, forward, inverse
from lerobot_act_chunking.envs.aloha.experts.motion import (
    Script,
    miss_first_grasp,
    one_arm_after_the_other,
    turned,
    turned_pose,
)
from lerobot_act_chunking.envs.aloha.instructions import Goal
from lerobot_act_chunking.envs.aloha.tasks import get_task
from lerobot_act_chunking.envs.aloha.world import CONTROL_PERIOD
from lerobot_act_chunking.envs.demonstration import ExpertOptions, Ranges
from lerobot_act_chunking.envs.strokes import (
    ArmScript,
    ExpertPlan,
    blend,
    detour_of,
    executed,
    shift_free,
    step_times,
)
from lerobot_act_chunking.errors import ConfigurationError, unknown_choice

MAX_STEPS = 400
"""Length of gym-aloha's episodes, in control steps."""

_SCRIPTS: dict[str, Callable[..., Script]] = {
    "transfer_cube": transfer_cube.script,
    "insertion": insertion.script,
    "transfer_modes": transfer_cube.script,
    "language_transfer": transfer_cube.script,
}
_STEPWISE: dict[str, Callable[..., Script]] = {
    "transfer_cube": stepwise.transfer_cube,
    "insertion": stepwise.insertion,
    "transfer_modes": stepwise.transfer_cube,
    "language_transfer": stepwise.transfer_cube,
}
_HOME_GRIPPER = (0.09985,)  # gym-aloha starts with all but closed fingers
_ARM_JOINTS = [*range(6), *range(7, 13)]
_MAX_TURN = 0.1  # [rad]; closing fingers straighten an object that is turned less

RANGES: Ranges = {
    "speed": (0.7, 1.5, "times the nominal pace"),
    "waypoint_noise": (0.0, 0.03, "m"),
    "action_noise": (0.0, 0.05, "rad"),
    "dwell": (0.0, 1.0, "s"),
    "dwell_after": (0.0, 1.0, "s"),
    "dwell_spread": (0.0, 0.7, "of the logarithm"),
    "pace_change": (0.0, 0.3, "of the logarithm"),
    "idle_start": (0.0, 1.5, "s"),
    "idle_end": (0.0, 1.5, "s"),
    "detour": (-0.08, 0.08, "m"),
    "overshoot": (0.0, 0.15, "of a free movement"),
    "hand_noise": (0.0, 0.05, "rad"),
    "tremor": (0.0, 0.02, "rad"),
    "missed_grasps": (0, 1, "grasps"),
    "one_arm_first": (0, 1, "arms"),
    "constant_speed": (0, 1, "(no or yes)"),
    "stepwise": (0, 1, "(no or yes)"),
    "latency": (0.0, 0.2, "s"),
    "dropped_frames": (0.0, 0.2, "of the control steps"),
}
"""Outside these the experts fail too often to demonstrate anything."""


def plan(
    task: str,
    object_pose: np.ndarray,
    options: ExpertOptions,
    rng: np.random.Generator,
    *,
    mode: int = 0,
    goal: Goal = Goal(),  # noqa: B008 (it is frozen)
) -> ExpertPlan:
    """Plan one episode.

    Args:
        task: one of ``TASKS``.
        object_pose: (7,), (14,) or (21,), x y z [m] and quaternion qw qx qy qz per object, unturned as
            gym-aloha places them.
        options: pace, noise and pauses.
        rng: source of the noise; a noise-free plan draws nothing from it.
        mode: which of the task's ways of doing it.
        goal: which cube is to be handed to which arm.

    Returns:
        The joint targets, 50 per second. Without noise they are a smooth function of ``object_pose``.

    Raises:
        ConfigurationError: unknown task or mode; a pose that is malformed, turned or out of reach; options
            outside their ranges, or that stretch the plan beyond ``MAX_STEPS``.
    """
    options.check(RANGES)
    pose = _checked_pose(task, object_pose)
    script = _script(task, pose, mode, _STEPWISE if options.stepwise else _SCRIPTS, goal)
    if options.missed_grasps:
        script = miss_first_grasp(script)
    if options.one_arm_first:
        script = one_arm_after_the_other(script)
    times = step_times(script, options, rng, period=CONTROL_PERIOD, most_steps=MAX_STEPS)
    left = _targets("left", script.left, times, options, rng)
    right = _targets("right", script.right, times, options, rng)
    actions = np.concatenate([left, right], axis=1)
    arms = (len(actions), len(_ARM_JOINTS))
    actions[:, _ARM_JOINTS] += options.hand(arms, rng, period=CONTROL_PERIOD)
    commands = executed(actions, _ARM_JOINTS, options, rng, period=CONTROL_PERIOD)
    return ExpertPlan(actions, commands)


def _script(
    task: str, pose: np.ndarray, mode: int, scripts: dict[str, Callable[..., Script]], goal: Goal
) -> Script:
    ways = get_task(task)
    if not 0 <= mode < ways.modes:
        raise unknown_choice(f"mode of {task}", mode, map(str, range(ways.modes)))
    if ways.cubes:
        cube = pose[7 * goal.index :][:7]
        return scripts[task](cube) if goal.taker == "left" else turned(scripts[task](turned_pose(cube)))
    return scripts[task](pose, ways.hand_overs[mode]) if ways.hand_overs else scripts[task](pose)


def _checked_pose(task: str, object_pose: np.ndarray) -> np.ndarray:
    size = get_task(task).pose_size
    pose = np.asarray(object_pose, dtype=np.float64)
    if pose.shape != (size,) or not np.isfinite(pose).all():
        raise ConfigurationError(
            f"the object pose of {task} is {size} finite numbers, x y z qw qx qy qz per object; "
            f"got shape {pose.shape}: {pose.tolist()}"
        )
    quaternions = pose.reshape(-1, 7)[:, 3:]
    if np.any(np.abs(quaternions[:, 0]) < np.cos(_MAX_TURN / 2) * np.linalg.norm(quaternions, axis=1)):
        raise ConfigurationError(
            f"the expert grasps objects turned by less than {_MAX_TURN} rad, qw qx qy qz = 1 0 0 0; "
            f"got {quaternions.tolist()}"
        )
    return pose


def _targets(
    arm: Arm, script: ArmScript, times: np.ndarray, options: ExpertOptions, rng: np.random.Generator
) -> np.ndarray:
    """(T, 7) joint and gripper targets of one arm."""
    noise = options.waypoint_noise
    strokes = shift_free(script.tool, noise, rng) if noise > 0 else script.tool
    straight = bool(options.constant_speed)

    def joints_of(overshoot: float) -> np.ndarray:
        tool = blend(times, forward(arm, HOME_JOINTS), strokes, overshoot, constant_speed=straight)
        tool[:, 1] += detour_of(times, script.tool, options.detour)
        return inverse(arm, tool)

    try:
        joints = joints_of(options.overshoot)
    except ConfigurationError:  # nobody shoots beyond where the arm reaches
        joints = joints_of(0.0)
    fingers = blend(times, _HOME_GRIPPER, script.gripper, constant_speed=straight)
    return np.concatenate([joints, fingers], axis=1)
