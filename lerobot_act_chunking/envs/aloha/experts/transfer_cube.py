"""The script of transfer_cube: the right arm picks the cube from above, the left arm takes it head-on.

The right fingers come down vertically on the two sides of the cube that lie along world x. On the way up the
gripper swings to the horizontal, which turns the cube by exactly 90 degrees: it is level again, held from
above and below, when the left gripper, also horizontal, closes on its two free sides. The pairs of fingers
cannot meet, so errors of more than a centimetre in any direction still end in a hand-over.

During the hand-over both arms drift together, so that no moment of the episode looks like a standstill:
policies trained on experts that pause get stuck in the pauses.
"""

import numpy as np

from lerobot_act_chunking.envs.aloha.experts.kinematics import bearing
from lerobot_act_chunking.envs.aloha.experts.motion import Script
from lerobot_act_chunking.envs.strokes import ArmScript, Stroke

_DOWN, _LEVEL = np.pi / 2, 0.0
_RIGHT_ROLL = np.pi / 2  # fingers open along world x when vertical, along world z when horizontal
_OPEN, _CLOSED = (1.0,), (0.0,)
_CUBE_HEIGHT = 0.02
_MEETING = (0.0, 0.5, 0.24)
_HALF_DRIFT = 0.015  # [m] along world x, on either side of the meeting point
_WAITING_X = (-0.15, -0.105)  # of the taking arm: within its reach, out of the other's way
_DRIFT_TIME = (3.1, 4.8)
# The cube sags a little between the right fingers; the left hand meets it there, slightly past its middle.
_SAG, _REACH_PAST = 0.006, 0.006


def script(object_pose: np.ndarray, meeting: tuple[float, float, float] = _MEETING) -> Script:
    """The script for a cube at ``object_pose`` (7,) that changes hands at ``meeting`` [m]."""
    x, y = object_pose[:2].tolist()
    roll = bearing("right", x, y) + _RIGHT_ROLL
    return Script(
        left=_taking_arm(meeting),
        right=_giving_arm(x, y, roll, meeting),
        duration=5.4,
        pauses=(1.8, 3.85),
        pauses_after=(2.0, 4.4),
    )


def _giving_arm(x: float, y: float, roll: float, meeting: tuple[float, float, float]) -> ArmScript:
    meeting_x, meeting_y, meeting_z = meeting
    from_x, to_x = meeting_x + _HALF_DRIFT, meeting_x - _HALF_DRIFT

    def horizontal(at_x: float) -> tuple[float, ...]:
        return (at_x, meeting_y, meeting_z, _LEVEL, _RIGHT_ROLL)

    return ArmScript(
        tool=(
            Stroke(-0.25, 1.3, (x, y, 0.13, _DOWN, roll), free=True),
            Stroke(0.8, 1.85, (x, y, _CUBE_HEIGHT, _DOWN, roll)),
            Stroke(1.75, 2.85, (x, y, 0.14, _DOWN, roll), free=True),
            Stroke(1.95, 3.45, horizontal(from_x + 0.08)),
            Stroke(2.95, 3.75, horizontal(from_x)),
            Stroke(*_DRIFT_TIME, horizontal(to_x)),
            Stroke(4.1, 5.6, horizontal(to_x + 0.14)),
        ),
        gripper=(Stroke(-0.1, 0.9, _OPEN), Stroke(1.55, 1.95, _CLOSED), Stroke(3.95, 4.35, _OPEN)),
    )


def _taking_arm(meeting: tuple[float, float, float]) -> ArmScript:
    meeting_x, meeting_y, meeting_z = meeting
    from_x, to_x = meeting_x + _HALF_DRIFT, meeting_x - _HALF_DRIFT
    waiting_x = float(np.clip(from_x - 0.12, *_WAITING_X))

    def horizontal(at_x: float) -> tuple[float, ...]:
        return (at_x, meeting_y, meeting_z - _SAG, _LEVEL, 0.0)

    return ArmScript(
        tool=(
            Stroke(-0.25, 3.0, horizontal(waiting_x), free=True),
            Stroke(2.7, 3.75, horizontal(from_x + _REACH_PAST)),
            Stroke(*_DRIFT_TIME, horizontal(to_x + _REACH_PAST)),
            Stroke(4.15, 5.6, horizontal(to_x - 0.085)),
        ),
        gripper=(Stroke(0.8, 2.4, _OPEN), Stroke(3.5, 3.9, _CLOSED)),
    )
