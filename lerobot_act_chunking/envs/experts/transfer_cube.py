"""The script of transfer_cube: the right arm picks the cube from above, the left arm takes it head-on.

The right fingers come down vertically on two sides of the cube. On the way up the gripper swings to the
horizontal, which turns the cube by exactly 90 degrees: it is level again when the left gripper, also
horizontal and rolled by 90 degrees, closes on its top and bottom. The two pairs of fingers hold different
faces and cannot meet, so an error of a centimetre in any direction still ends in a hand-over.
"""

import numpy as np

from lerobot_act_chunking.envs.experts.kinematics import bearing
from lerobot_act_chunking.envs.experts.motion import ArmScript, Script, Stroke

_DOWN, _LEVEL, _SIDEWAYS = np.pi / 2, 0.0, np.pi / 2
_OPEN, _CLOSED = (1.0,), (0.0,)
_CUBE_HEIGHT = 0.02
_MEETING = (0.0, 0.5, 0.25)


def script(object_pose: np.ndarray) -> Script:
    """The script for a cube at ``object_pose`` (7,)."""
    x, y = object_pose[:2].tolist()
    return Script(
        left=_taking_arm(),
        right=_giving_arm(x, y, bearing("right", x, y)),
        duration=5.6,
        pauses=(1.9, 3.7),
    )


def _giving_arm(x: float, y: float, roll: float) -> ArmScript:
    meet_x, meet_y, meet_z = _MEETING
    return ArmScript(
        tool=(
            Stroke(-0.25, 1.3, (x, y, 0.13, _DOWN, roll), free=True),
            Stroke(0.8, 1.8, (x, y, _CUBE_HEIGHT, _DOWN, roll)),
            Stroke(1.9, 2.9, (x, y, 0.14, _DOWN, roll)),
            Stroke(2.1, 3.4, (meet_x + 0.08, meet_y, meet_z, _LEVEL, 0.0), free=True),
            Stroke(3.0, 3.7, (*_MEETING, _LEVEL, 0.0)),
            Stroke(4.1, 5.8, (meet_x + 0.14, meet_y, meet_z, _LEVEL, 0.0)),
        ),
        gripper=(Stroke(-0.1, 0.9, _OPEN), Stroke(1.6, 2.0, _CLOSED), Stroke(4.0, 4.4, _OPEN)),
    )


def _taking_arm() -> ArmScript:
    meet_x, meet_y, meet_z = _MEETING
    return ArmScript(
        tool=(
            Stroke(-0.25, 3.0, (meet_x - 0.12, meet_y, meet_z, _LEVEL, _SIDEWAYS), free=True),
            Stroke(2.8, 3.7, (*_MEETING, _LEVEL, _SIDEWAYS)),
            Stroke(4.3, 5.8, (meet_x - 0.1, meet_y, meet_z, _LEVEL, _SIDEWAYS)),
        ),
        gripper=(Stroke(1.2, 2.6, _OPEN), Stroke(3.5, 3.9, _CLOSED)),
    )
