"""FetchPush: square to the block's faces, first along x, then along y.

Made to be imitated. Along a diagonal the fingers would touch the block at an edge, and it turns off the line
at the smallest error. And where a push ends is where the gripper is led, not a distance at which it stops: an
imitator would stop too early, since most of what it has seen is an arm at rest.
"""

from dataclasses import dataclass

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

_ARRIVED = 0.03  # [m] between block and target; success is 0.05
_ALIGNED = 0.02  # [m] along an axis, which is then left alone
_RETURN = 0.03  # [m] off in x at which a push along y that has begun is given up
_CONTACT = 0.046  # [m] between gripper and block when they touch
_BEHIND = 0.07  # [m] behind the block where a push begins
_BESIDE = 0.09  # [m] between gripper and block, once it has pushed
_ASIDE = 0.02  # [m] off the line at which a push would turn the block
_PUSH, _STEER = 0.5, 0.5  # of the way to where the push ends, and back to the line, in a step
_X, _Y = np.eye(3)[:2]


@dataclass(frozen=True)
class _Leg:
    """A push of the block along one axis.

    Attributes:
        line: (3,) unit vector of the push.
        distance: of the block, still to go [m].
        way: of the gripper, still to go [m].
        ahead: where the gripper is, along the line from the block [m].
        aside: (3,) off the line on the table [m].
        ready: whether the gripper is behind the block and may push.
    """

    line: np.ndarray
    distance: float
    way: float
    ahead: float
    aside: np.ndarray
    ready: bool


def push(observation: Observation, style: Style) -> Move:
    """Go around the block over it, come down behind, push it along one axis; then along the other."""
    gripper, block = observation["grip_pos"], observation["object_pos"]
    leg = _next(_leg(_X, observation), _leg(_Y, observation), observation)
    if leg is None:
        return Move(wait(STILL))
    if leg.ready:
        pace = style.speed * np.clip(_PUSH * leg.way / FULL_ACTION, -1.0, 1.0)
        arm = pace * leg.line - _STEER * leg.aside / FULL_ACTION
        arm[2] = (block - gripper)[2] / FULL_ACTION
        return Move(with_fingers(arm, STILL), pause=None if leg.ahead > -_CONTACT else wait(STILL))
    return Move(with_fingers(go_behind(block - _BEHIND * leg.line, observation, style), STILL))


def _leg(axis: np.ndarray, observation: Observation) -> _Leg:
    gripper, block, target = observation["grip_pos"], observation["object_pos"], observation["desired_goal"]
    distance = float((target - block) @ axis)
    line = np.copysign(1.0, distance) * axis
    ahead = float((gripper - block) @ line)
    aside = (gripper - block) * [1, 1, 0] - ahead * line
    return _Leg(
        line,
        abs(distance),
        float((target - gripper) @ line) - _CONTACT,
        ahead,
        aside,
        is_behind(ahead, aside, (gripper - block)[2], _ASIDE),
    )


def _next(x: _Leg, y: _Leg, observation: Observation) -> _Leg | None:
    """Which one to go on with; none where the push is over and nothing is left to do."""
    if flat_distance(observation["desired_goal"], observation["object_pos"]) < _ARRIVED:
        return _last(
            x, y, bool(np.linalg.norm(observation["grip_pos"] - observation["object_pos"]) < _BESIDE)
        )
    pushes_y = y.ready and y.distance > _ALIGNED  # which bears a larger error in x
    if x.distance >= (_RETURN if pushes_y else _ALIGNED):
        return x
    if y.distance >= _ALIGNED:
        return y
    return max(x, y, key=lambda leg: leg.distance)


def _last(x: _Leg, y: _Leg, beside: bool) -> _Leg | None:
    """The push to end where the block has arrived; one that lay there from the start is gone to, too."""
    if x.ready or y.ready:
        return x if x.ready else y
    return None if beside else max(x, y, key=lambda leg: leg.distance)
