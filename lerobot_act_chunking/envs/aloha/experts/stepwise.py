"""Another way of doing both tasks: from way-point to way-point, with a rest at each, grippers inclined.

As in ACT's scripted demonstrations (Zhao et al. 2023) no movement begins before the one before it has ended,
the grippers keep 60 degrees below the horizon from the approach on, and the arms meet at a standstill.
"""

from collections.abc import Sequence

import numpy as np

from lerobot_act_chunking.envs.aloha.experts.motion import Script
from lerobot_act_chunking.envs.strokes import ArmScript, Stroke

_PITCH, _LEVEL, _SIDEWAYS = np.pi / 3, 0.0, np.pi / 2
_OPEN, _CLOSED = (1.0,), (0.0,)
_MEETING_Y = 0.5
_MEETING = (0.0, _MEETING_Y, 0.25)
_WAITING_X = -0.15  # of the taking arm
_FIRST_MOTION = 0.2  # [s]
_ABOVE = 0.1  # of the way-point before a grasp, over it

_CUBE_Z = 0.022
_PEG_Z, _SOCKET_Z, _INSERTION_Z = 0.02, 0.024, 0.2
_PEG_CENTRE, _SOCKET_CENTRE = 0.01, 0.022  # heights of the objects lying on the table
_SOCKET_X = -0.05  # of the socket's centre where they meet
_PEG_READY, _PEG_PUSHED = 0.2, 0.07  # from the socket's centre to the peg's


def transfer_cube(object_pose: np.ndarray, meeting: tuple[float, float, float] = _MEETING) -> Script:
    """The script for a cube at ``object_pose`` (7,) that changes hands at ``meeting`` [m]."""
    x, y = object_pose[:2].tolist()
    meeting_x, *meeting_yz = meeting
    right = _arm(
        [
            (1.4, (x, y, _CUBE_Z + _ABOVE, _PITCH, 0.0)),
            (2.0, (x, y, _CUBE_Z, _PITCH, 0.0)),
            (2.5, None),
            (3.0, (x, y, _CUBE_Z + _ABOVE, _PITCH, 0.0)),
            (4.0, (meeting_x, *meeting_yz, _PITCH, 0.0)),
            (5.4, None),
            (6.0, (meeting_x + 0.12, *meeting_yz, _PITCH, 0.0)),
        ],
        [(0.4, 1.2, _OPEN), (2.05, 2.45, _CLOSED), (5.0, 5.35, _OPEN)],
    )
    left = _arm(
        [
            (1.8, (_WAITING_X, *meeting_yz, _LEVEL, _SIDEWAYS)),
            (4.0, None),
            (4.5, (meeting_x, *meeting_yz, _LEVEL, _SIDEWAYS)),
            (5.4, None),
            (6.0, (meeting_x - 0.1, *meeting_yz, _LEVEL, _SIDEWAYS)),
        ],
        [(0.4, 1.2, _OPEN), (4.55, 4.95, _CLOSED)],
    )
    return Script(left, right, duration=6.0, pauses=(2.02, 4.52), pauses_after=(2.47, 4.97))


def insertion(object_pose: np.ndarray) -> Script:
    """The script for a peg and a socket at ``object_pose`` (14,)."""
    peg_x, peg_y, socket_x, socket_y = object_pose[[0, 1, 7, 8]].tolist()
    peg_z = _INSERTION_Z + (_PEG_Z - _PEG_CENTRE)
    socket_z = _INSERTION_Z + (_SOCKET_Z - _SOCKET_CENTRE)
    right = _inserting_arm((peg_x, peg_y, _PEG_Z), peg_z, _SOCKET_X + _PEG_READY, _SOCKET_X + _PEG_PUSHED)
    left = _inserting_arm((socket_x, socket_y, _SOCKET_Z), socket_z, _SOCKET_X, _SOCKET_X)
    return Script(left, right, duration=5.6, pauses=(2.02,), pauses_after=(2.47, 4.22))


def _inserting_arm(
    grasp: tuple[float, float, float], meeting_z: float, ready_x: float, pushed_x: float
) -> ArmScript:
    x, y, z = grasp
    return _arm(
        [
            (1.4, (x, y, z + _ABOVE, _PITCH, 0.0)),
            (2.0, (x, y, z, _PITCH, 0.0)),
            (2.5, None),
            (3.0, (x, y, z + _ABOVE, _PITCH, 0.0)),
            (4.2, (ready_x, _MEETING_Y, meeting_z, _PITCH, 0.0)),
            (4.3, None),
            (5.3, (pushed_x, _MEETING_Y, meeting_z, _PITCH, 0.0)),
        ],
        [(0.4, 1.2, _OPEN), (2.05, 2.45, _CLOSED)],
    )


def _arm(
    way_points: Sequence[tuple[float, tuple[float, ...] | None]],
    gripper: Sequence[tuple[float, float, tuple[float, ...]]],
) -> ArmScript:
    """An arm that is at each way-point at its time [s]; None: it stays until then. The first one is free."""
    strokes, start = [], _FIRST_MOTION
    for end, target in way_points:
        if target is not None:
            strokes.append(Stroke(start, end, target, free=not strokes))
        start = end
    return ArmScript(tuple(strokes), tuple(Stroke(*each) for each in gripper))
