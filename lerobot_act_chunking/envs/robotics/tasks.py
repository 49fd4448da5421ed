"""The table of tasks: every environment of gymnasium-robotics that this package knows, one row each.

Layouts, cameras, names and limits are gymnasium-robotics 1.4's, and tests compare them with the originals.
"""

from collections.abc import Mapping
from typing import Any

from lerobot_act_chunking.envs.robotics.layout import Part, RoboticsTask
from lerobot_act_chunking.errors import unknown_choice


def _goal_reached(info: Mapping[str, Any]) -> bool:
    return bool(info["is_success"])


def _adroit_success(info: Mapping[str, Any]) -> bool:
    return bool(info["success"])


def _nothing_left_to_do(info: Mapping[str, Any]) -> bool:
    return not info["tasks_to_complete"]


def _robot(name: str, size: int, *, velocity: bool = False) -> Part:
    return Part(name, size, robot=True, velocity=velocity)


# Positions [m], rotations [rad]; velocities are per control step, the object's relative to the gripper's.
_GRIPPER = (
    _robot("grip_pos", 3),
    _robot("gripper_state", 2),
    _robot("grip_velp", 3, velocity=True),
    _robot("gripper_vel", 2, velocity=True),
)
_GRIPPER_AND_OBJECT = (
    _robot("grip_pos", 3),
    Part("object_pos", 3),
    Part("object_rel_pos", 3),
    _robot("gripper_state", 2),
    Part("object_rot", 3),
    Part("object_velp", 3, velocity=True),
    Part("object_velr", 3, velocity=True),
    _robot("grip_velp", 3, velocity=True),
    _robot("gripper_vel", 2, velocity=True),
)


def _fetch(instruction: str, parts: tuple[Part, ...] = _GRIPPER_AND_OBJECT) -> RoboticsTask:
    return RoboticsTask(
        instruction,
        parts,
        actions=("x", "y", "z", "gripper"),
        fps=25,
        episode_length=50,
        succeeds=_goal_reached,
        goal=(Part("desired_goal", 3),),
        cameras=("view", "head_camera_rgb", "gripper_camera_rgb", "lidar", "external_camera_0"),
    )


_FRANKA_ARM = tuple(f"panda0_joint{i}" for i in range(1, 8))
_KITCHEN = RoboticsTask(
    "Turn both burners and the light on, open both cabinets and the microwave, move the kettle.",
    # Noisy, as the original observes. Of the objects: joint positions and the kettle's pose, then velocities.
    (
        _robot("robot_qpos", 9),
        _robot("robot_qvel", 9, velocity=True),
        Part("object_qpos", 21),
        Part("object_qvel", 20, velocity=True),
    ),
    actions=(*_FRANKA_ARM, "r_gripper_finger_joint", "l_gripper_finger_joint"),
    fps=12,
    episode_length=280,
    succeeds=_nothing_left_to_do,
    goal=(
        Part("bottom burner", 2),
        Part("top burner", 2),
        Part("light switch", 2),
        Part("slide cabinet", 1),
        Part("hinge cabinet", 2),
        Part("microwave", 1),
        Part("kettle", 7),
    ),
    cameras=("view", "left_cap", "right_cap"),
)

_WRIST = ("WRJ1", "WRJ0")
_FINGERS = tuple(f"{finger}J{i}" for finger in ("FF", "MF", "RF") for i in (3, 2, 1, 0))
_LITTLE_FINGER_AND_THUMB = tuple(f"{finger}J{i}" for finger in ("LF", "TH") for i in (4, 3, 2, 1, 0))
_ADROIT_HAND = (*_WRIST, *_FINGERS, *_LITTLE_FINGER_AND_THUMB)
_ADROIT_CAMERAS = ("view", "fixed", "vil_camera")


def _adroit(
    instruction: str,
    parts: tuple[Part, ...],
    arm: tuple[str, ...] = (),
    cameras: tuple[str, ...] = _ADROIT_CAMERAS,
) -> RoboticsTask:
    return RoboticsTask(
        instruction,
        parts,
        actions=(*arm, *_ADROIT_HAND),
        fps=100,
        episode_length=200,
        succeeds=_adroit_success,
        cameras=cameras,
    )


_DOOR = _adroit(
    "Undo the latch and swing the door open.",
    (
        _robot("joints", 27),  # all but the first: the original leaves the arm's translation out
        Part("latch", 1),
        Part("door_hinge", 1),
        _robot("palm_pos", 3),
        Part("handle_pos", 3),
        Part("palm_to_handle", 3),
        Part("door_open", 1),
    ),
    arm=("ARTz", "ARRx", "ARRy", "ARRz"),
)
_HAMMER = _adroit(
    "Pick up the hammer and drive the nail into the board.",
    (
        _robot("joints", 26),
        Part("nail", 1),
        Part("hammer_velocity", 6, velocity=True),
        _robot("palm_pos", 3),
        Part("hammer_pos", 3),
        Part("hammer_rot", 3),
        Part("nail_pos", 3),
        Part("nail_force", 1),
    ),
    arm=("ARRx", "ARRy"),
)
_PEN = _adroit(
    "Turn the pen in the hand to match the target's orientation.",
    (
        _robot("joints", 24),
        Part("pen_pos", 3),
        Part("pen_velocity", 6, velocity=True),
        Part("pen_direction", 3),
        Part("target_direction", 3),
        Part("target_to_pen", 3),
        Part("direction_error", 3),
    ),
    cameras=(*_ADROIT_CAMERAS, "view_1", "view_2", "view_3", "view_4", "view_5"),
)
_RELOCATE = _adroit(
    "Pick up the ball and carry it to the target.",
    (_robot("joints", 30), Part("ball_to_palm", 3), Part("target_to_palm", 3), Part("target_to_ball", 3)),
    arm=("ARTx", "ARTy", "ARTz", "ARRx", "ARRy", "ARRz"),
)

# The shadow hand couples the outermost joint of each finger to the next, so that it has no actuator.
_SHADOW_HAND = tuple(name for name in _ADROIT_HAND if name not in ("FFJ0", "MFJ0", "RFJ0", "LFJ0"))


def _shadow(instruction: str, parts: tuple[Part, ...], goal: Part, episode_length: int = 100) -> RoboticsTask:
    return RoboticsTask(
        instruction,
        (_robot("robot_qpos", 24), _robot("robot_qvel", 24, velocity=True), *parts),
        actions=_SHADOW_HAND,
        fps=25,
        episode_length=episode_length,
        succeeds=_goal_reached,
        goal=(goal,),
    )


_OBJECT_IN_HAND = ((Part("object_qvel", 6, velocity=True), Part("object_pose", 7)), Part("desired_pose", 7))

TASKS: dict[str, RoboticsTask] = {
    "FetchReach-v4": _fetch("Move the gripper to the target.", _GRIPPER),
    "FetchPush-v4": _fetch("Push the block to the target."),
    "FetchSlide-v4": _fetch("Hit the puck so that it slides to the target."),
    "FetchPickAndPlace-v4": _fetch("Pick up the block and bring it to the target."),
    "FrankaKitchen-v1": _KITCHEN,
    "AdroitHandDoor-v1": _DOOR,
    "AdroitHandHammer-v1": _HAMMER,
    "AdroitHandPen-v1": _PEN,
    "AdroitHandRelocate-v1": _RELOCATE,
    "HandReach-v3": _shadow(
        "Move the fingertips to their targets.",
        (_robot("fingertips", 15),),
        Part("desired_fingertips", 15),
        episode_length=50,
    ),
    "HandManipulateBlock-v1": _shadow("Turn the block in the hand to the target pose.", *_OBJECT_IN_HAND),
    "HandManipulateEgg-v1": _shadow("Turn the egg in the hand to the target pose.", *_OBJECT_IN_HAND),
    "HandManipulatePen-v1": _shadow("Turn the pen in the hand to the target pose.", *_OBJECT_IN_HAND),
}
"""Every task by the original's Gymnasium id."""


def get_task(name: str) -> RoboticsTask:
    """The task called ``name``.

    Raises:
        ConfigurationError: no row of the table has this name.
    """
    if name not in TASKS:
        raise unknown_choice("gymnasium_robotics task", name, TASKS)
    return TASKS[name]
