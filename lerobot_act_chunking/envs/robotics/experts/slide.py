"""FetchSlide: hit the puck so that friction stops it at the target, which is out of the arm's reach."""

import numpy as np

from lerobot_act_chunking.envs.robotics.experts.controller import (
    FULL_ACTION,
    STILL,
    Move,
    Observation,
    Style,
    flat_distance,
    go_behind,
    is_behind,
    wait,
    with_fingers,
)

_FRICTION = 0.00158  # [m per step^2] by which the sliding puck slows down: 0.1 g at 25 steps a second
_ARRIVED = 0.03  # [m] between puck and target; success is 0.05
_RUN_UP = 0.12  # [m] behind the puck where the run-up begins
_ASIDE = 0.02  # [m] off the line at which a hit would send the puck aside
_TOUCH = 0.07  # [m] between gripper and puck beyond which they are apart
_MOVING = 0.004  # [m per step]
# The puck leaves faster than the gripper comes, and the gripper slower than it is told: commanded speed over
# the speed that the puck needs, at the target and per metre from it; measured.
_GAIN, _GAIN_PER_METRE = 0.95, 0.3


def slide(observation: Observation, style: Style) -> Move:
    """Come down behind the puck, hit it with the speed that takes it to the target, and let go.

    The speed does not depend on the pace that was asked for: any other would miss.
    """
    gripper, puck, target = observation["grip_pos"], observation["object_pos"], observation["desired_goal"]
    distance = flat_distance(target, puck)
    line = np.append((target - puck)[:2] / max(distance, 1e-9), 0.0)
    # The object's is relative to the gripper's.
    velocity = observation["object_velp"] + observation["grip_velp"]
    needed = np.sqrt(2 * _FRICTION * distance)
    slipped_away = flat_distance(velocity, np.zeros(3)) > _MOVING and flat_distance(gripper, puck) > _TOUCH
    if distance < _ARRIVED or velocity @ line >= 0.98 * needed or slipped_away:
        return Move(wait(STILL))
    ahead = float((gripper - puck) @ line)
    aside = (gripper - puck) * [1, 1, 0] - ahead * line
    if is_behind(ahead, aside, gripper[2] - puck[2], _ASIDE):
        arm = ((_GAIN + _GAIN_PER_METRE * distance) * needed * line - aside) / FULL_ACTION
        arm[2] = (puck - gripper)[2] / FULL_ACTION
        arm /= max(1.0, np.abs(arm).max())
        return Move(with_fingers(arm, STILL), pause=None if ahead > -_TOUCH else wait(STILL))
    return Move(with_fingers(go_behind(puck - _RUN_UP * line, observation, style), STILL))
