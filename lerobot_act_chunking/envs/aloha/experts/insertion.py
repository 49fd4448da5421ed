"""The script of insertion: the right arm lifts the peg, the left arm the socket, and they push together.

Both tools stay vertical, where errors of the joints move the fingertips least. Their closing fingers centre
the objects in y, and the fingertips skim the table while they close, so that each object sits at a known
height in the hand. The tools then meet end to end along x and push past the depth at which the peg reaches
the pin, so that an error along x only lets the peg slide in the fingers. The opening leaves 8 mm around the
peg: what is left to err is height.

From before contact to the end both arms rise together, so that the pushing arms are never at a standstill.
"""

import numpy as np

from lerobot_act_chunking.envs.aloha.experts.kinematics import bearing
from lerobot_act_chunking.envs.aloha.experts.motion import Script
from lerobot_act_chunking.envs.strokes import ArmScript, Stroke

_DOWN = np.pi / 2
_OPEN, _CLOSED = (1.0,), (0.0,)
_GRASP_HEIGHT = 0.014  # of the grasp point; the tips end 1 mm lower than the table and bend to it
_PEG_HEIGHT, _SOCKET_HEIGHT = 0.01, 0.022  # centres of the objects lying on the table
# Each object is held 2 cm outside its centre, which keeps the grippers apart.
_PEG_OFFSET, _SOCKET_OFFSET = 0.02, -0.02
_MEETING_X, _MEETING_Y, _MEETING_Z = -0.05, 0.5, 0.2  # of the socket's centre
# Distance from the socket's centre to the peg's: they touch the pin at 0.10.
_PEG_READY, _PEG_PUSHED = 0.17, 0.07
_RISE, _RISE_TIME = 0.06, (3.3, 5.6)


def script(object_pose: np.ndarray) -> Script:
    """The script for a peg and a socket at ``object_pose`` (14,)."""
    peg_x, peg_y, socket_x, socket_y = object_pose[[0, 1, 7, 8]].tolist()
    peg_z = _MEETING_Z + _SOCKET_HEIGHT - _PEG_HEIGHT  # what brings both centres to one height
    right = _arm(
        grasp=(peg_x + _PEG_OFFSET, peg_y, bearing("right", peg_x + _PEG_OFFSET, peg_y)),
        ready=(_MEETING_X + _PEG_READY + _PEG_OFFSET, peg_z),
        pushed_x=_MEETING_X + _PEG_PUSHED + _PEG_OFFSET,
    )
    left = _arm(
        grasp=(socket_x + _SOCKET_OFFSET, socket_y, bearing("left", socket_x + _SOCKET_OFFSET, socket_y)),
        ready=(_MEETING_X + _SOCKET_OFFSET - 0.05, _MEETING_Z),
        pushed_x=_MEETING_X + _SOCKET_OFFSET,
    )
    return Script(left, right, duration=5.0, pauses=(1.8,), pauses_after=(2.0, 3.45))


def _arm(grasp: tuple[float, float, float], ready: tuple[float, float], pushed_x: float) -> ArmScript:
    x, y, roll = grasp
    ready_x, z = ready
    return ArmScript(
        tool=(
            Stroke(-0.25, 1.3, (x, y, 0.12, _DOWN, roll), free=True),
            Stroke(0.8, 1.85, (x, y, _GRASP_HEIGHT, _DOWN, roll)),
            Stroke(1.8, 2.9, (x, y, 0.14, _DOWN, roll), free=True),
            Stroke(1.9, 3.4, (ready_x, _MEETING_Y, z, _DOWN, 0.0)),
            Stroke(3.0, 4.2, (pushed_x, _MEETING_Y, z, _DOWN, 0.0)),
            Stroke(*_RISE_TIME, (pushed_x, _MEETING_Y, z + _RISE, _DOWN, 0.0)),
        ),
        gripper=(Stroke(-0.1, 0.9, _OPEN), Stroke(1.45, 1.85, _CLOSED)),
    )
