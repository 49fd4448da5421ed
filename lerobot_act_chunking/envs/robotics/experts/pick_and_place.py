"""FetchPickAndPlace: down onto the block, close, and carry it to the target."""

import numpy as np

from lerobot_act_chunking.envs.robotics.experts.controller import (
    CLOSE,
    OPEN,
    Move,
    Observation,
    Style,
    flat_distance,
    raised,
    shifted,
    toward,
    wait,
    with_fingers,
)

_BLOCK = 0.05  # the block's side [m]
_GRASP = 0.012  # [m] between gripper and block at which the fingers close
_HELD = 0.02  # the same while the block is held: it may have slipped
_LOOSE = 0.003  # opening [m] beyond the block's side up to which the fingers hold it
_MISS_LOW, _MISS_HIGH = 0.05, 0.09  # height [m] above the block at which fingers close on nothing
_HOVER, _FUNNEL = 0.1, 4.0  # height [m] above the block, and how steeply it is left close by


def pick_and_place(observation: Observation, style: Style) -> Move:
    """Approach from above in a funnel, grasp, go to the target and hold the block there."""
    gripper, block = observation["grip_pos"], observation["object_pos"]
    grasped = observation["gripper_state"].sum() < _BLOCK + _LOOSE
    if grasped and np.linalg.norm(gripper - block) < _HELD:
        # The block is what must be at the target, wherever between the fingers it sits.
        arm = toward(gripper + observation["desired_goal"] - block, observation, style)
        return Move(with_fingers(arm, CLOSE), pause_after=wait(CLOSE))
    aside = flat_distance(gripper, block)
    waypoint = raised(block, np.clip(_FUNNEL * (aside - _GRASP), 0.0, _HOVER))
    at_block = aside < _GRASP and abs(gripper[2] - block[2]) < _GRASP
    arm = toward(shifted(waypoint, observation, style), observation, style)
    if at_block:
        return Move(with_fingers(arm, CLOSE), pause=wait(OPEN))
    above = _MISS_LOW < gripper[2] - block[2] < _MISS_HIGH and aside < 2 * _GRASP
    return Move(with_fingers(arm, OPEN), misses=above)
