"""From a task and its objects to joint targets for a whole episode."""

import numpy as np

from lerobot_act_chunking.envs.demonstration import ExpertOptions, Ranges
from lerobot_act_chunking.envs.so_arm.experts import scripts
from lerobot_act_chunking.envs.so_arm.experts.kinematics import kinematics
from lerobot_act_chunking.envs.so_arm.model import CONTROL_PERIOD
from lerobot_act_chunking.envs.so_arm.tasks import get_task
from lerobot_act_chunking.envs.so_arm.world import HOME
from lerobot_act_chunking.envs.strokes import ExpertPlan, blend, detour_of, executed, shift_free, step_times
from lerobot_act_chunking.errors import ConfigurationError, unknown_choice

MAX_STEPS = 400
"""Length of an episode, in control steps."""

RANGES: Ranges = {
    "speed": (0.7, 1.5, "times the nominal pace"),
    "waypoint_noise": (0.0, 0.02, "m"),
    "action_noise": (0.0, 1.5, "degrees"),
    "dwell": (0.0, 1.0, "s"),
    "dwell_after": (0.0, 1.0, "s"),
    "dwell_spread": (0.0, 0.7, "of the logarithm"),
    "pace_change": (0.0, 0.3, "of the logarithm"),
    "idle_start": (0.0, 1.5, "s"),
    "idle_end": (0.0, 1.5, "s"),
    "detour": (-0.05, 0.05, "m"),
    "overshoot": (0.0, 0.15, "of a free movement"),
    "hand_noise": (0.0, 2.0, "degrees"),
    "tremor": (0.0, 1.5, "degrees"),
    "missed_grasps": (0, 1, "grasps"),
    "one_arm_first": (0, 1, "arms"),
    "constant_speed": (0, 1, "(no or yes)"),
    "stepwise": (0, 1, "(no or yes)"),
    "latency": (0.0, 0.2, "s"),
    "dropped_frames": (0.0, 0.2, "of the control steps"),
}
"""Outside these the expert fails too often to demonstrate anything; there is no second arm to wait for."""

_CLEARANCE = 0.008  # [m] of the finger that does not move from the cube, while the gripper is open
_ARM = range(5)


def plan(
    task: str, places: np.ndarray, options: ExpertOptions, rng: np.random.Generator, *, mode: int = 0
) -> ExpertPlan:
    """Plan one episode, from home to home.

    The targets lie where the servos, which sag under load, hold the joints that the inverse kinematics asks
    for; a person at a leader arm does the same by eye.

    Args:
        task: one of ``TASKS``.
        places: ``environment_state`` (E,) as the episode starts.
        options: pace, noise and pauses.
        rng: source of the noise; a noise-free plan draws nothing from it.
        mode: which of the task's ways of doing it.

    Raises:
        ConfigurationError: unknown task or mode; objects out of reach; options outside their ranges, or that
            stretch the plan beyond ``MAX_STEPS``.
    """
    options.check(RANGES)
    arm = kinematics()
    home = arm.units.to_radians(np.array(HOME))[:5]
    script = _script(task, places, arm.forward(home), mode, options)
    times = step_times(script, options, rng, period=CONTROL_PERIOD, most_steps=MAX_STEPS)
    strokes, straight = script.arm.tool, bool(options.constant_speed)
    if options.waypoint_noise > 0:
        strokes = shift_free(strokes, options.waypoint_noise, rng)
    tool = blend(times, arm.forward(home), strokes, options.overshoot, constant_speed=straight)
    tool[:, 1] += detour_of(times, script.arm.tool, options.detour)
    fingers = blend(times, HOME[-1:], script.arm.gripper, constant_speed=straight)
    _keep_clear(tool, fingers[:, 0])
    joints = arm.against_gravity(arm.inverse(tool, home))
    actions = np.concatenate([np.rad2deg(joints), fingers], axis=1)
    actions[:, _ARM] += options.hand((len(actions), len(_ARM)), rng, period=CONTROL_PERIOD)
    return ExpertPlan(actions, executed(actions, _ARM, options, rng, period=CONTROL_PERIOD))


def _script(
    task: str, places: np.ndarray, home: np.ndarray, mode: int, options: ExpertOptions
) -> scripts.Script:
    found = get_task(task)
    if not 0 <= mode < found.modes:
        raise unknown_choice(f"mode of {task}", mode, map(str, range(found.modes)))
    size = len(found.environment_names)
    if np.shape(places) != (size,) or not np.isfinite(places).all():
        raise ConfigurationError(f"the objects' places of {task} are {size} finite numbers, got {places}")
    make = scripts.stepwise if options.stepwise else scripts.smooth
    script = make(found, np.asarray(places), home.tolist(), mode)
    return scripts.missing_once(script) if options.missed_grasps else script


def _keep_clear(tool: np.ndarray, fingers: np.ndarray) -> None:
    opened = np.clip((fingers - scripts.HOLDING) / (scripts.OPEN - scripts.HOLDING), 0.0, 1.0)
    yaw = tool[:, 4]
    tool[:, :2] -= _CLEARANCE * opened[:, None] * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
