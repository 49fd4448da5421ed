"""Closed-form inverse kinematics of the ViperX arm with its forearm roll held at zero.

The last three axes of the arm meet in one point, so position and orientation separate. The experts need one
branch only: elbow up, forearm roll 0, tool in the vertical plane through the waist. There the solution is
unique and smooth wherever the wrist can reach, exact to rounding, and costs microseconds for a whole episode.
An iterative solver (mink) gives the same angles, which a test checks, but takes about a thousand times longer
and depends on where it starts.

A tool pose is (x, y, z, pitch, roll): the grasp point between the fingertips [m, world], the angle of the
fingers below the horizon [rad] and the turn about the finger axis [rad]. Link lengths are gym-aloha's.
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from lerobot_act_chunking.errors import ConfigurationError

Arm = Literal["left", "right"]

HOME_JOINTS = (0.0, -0.96, 1.16, 0.0, -0.3, 0.0)
"""Arm joints [rad] at the start of every gym-aloha episode."""

# Base position (x, y) [m] and the direction of world x in which each arm faces.
_BASES: dict[Arm, tuple[float, float, float]] = {"left": (-0.469, 0.5, 1.0), "right": (0.469, 0.5, -1.0)}
_SHOULDER_HEIGHT = 0.079 + 0.04805
_UPPER_ARM = float(np.hypot(0.05955, 0.3))
# The elbow sits in front of the shoulder at shoulder angle 0.
_UPPER_ARM_LEAN = float(np.arctan2(0.05955, 0.3))
_FOREARM = 0.2 + 0.1
# Shoulder, elbow and wrist angles [rad]; the other joints go all around.
_LOWEST, _HIGHEST = np.array([-1.85005, -1.76278, -1.8675]), np.array([1.25664, 1.6057, 2.23402])
# Wrist centre to grasp point: the gripper link, then 139 mm along fingers that end at 154 mm. The tips clear
# the table by 5 mm when the point is at the centre of a 4 cm cube.
_WRIST_TO_GRASP = 0.069744 + 0.139


def inverse(arm: Arm, tool: np.ndarray) -> np.ndarray:
    """Joint angles that put the grasp point at each tool pose.

    Args:
        arm: ``"left"`` or ``"right"``.
        tool: (T, 5) tool poses.

    Returns:
        (T, 6) joint angles [rad].

    Raises:
        ConfigurationError: a pose beyond the arm's reach.
    """
    x, y, z, pitch, roll = tool.T
    base_x, base_y, facing = _BASES[arm]
    ahead, aside = facing * (x - base_x), facing * (y - base_y)
    radius = np.hypot(ahead, aside) - _WRIST_TO_GRASP * np.cos(pitch)
    height = z - _SHOULDER_HEIGHT + _WRIST_TO_GRASP * np.sin(pitch)
    reach = np.hypot(radius, height)
    # Law of cosines in the triangle shoulder, elbow, wrist.
    cosine = (_UPPER_ARM**2 + reach**2 - _FOREARM**2) / (2 * _UPPER_ARM * reach)
    elevation = np.arctan2(height, radius) + np.arccos(np.clip(cosine, -1.0, 1.0))
    forearm_pitch = np.arctan2(
        _UPPER_ARM * np.sin(elevation) - height, radius - _UPPER_ARM * np.cos(elevation)
    )
    shoulder = np.pi / 2 - elevation - _UPPER_ARM_LEAN
    bends = np.stack([shoulder, forearm_pitch - shoulder, pitch - forearm_pitch], axis=-1)
    _check_reach(arm, tool, (np.abs(cosine) <= 1) & np.all((bends >= _LOWEST) & (bends <= _HIGHEST), axis=-1))
    waist, no_roll = np.arctan2(aside, ahead), np.zeros_like(x)
    return np.column_stack([waist, bends[:, :2], no_roll, bends[:, 2], roll])


def forward(arm: Arm, joints: Sequence[float] | np.ndarray) -> np.ndarray:
    """Tool pose (5,) of joint angles (6,) [rad] whose forearm roll is zero."""
    waist, shoulder, elbow, _, wrist, roll = joints
    lean, forearm_pitch, pitch = shoulder + _UPPER_ARM_LEAN, shoulder + elbow, shoulder + elbow + wrist
    radius = _UPPER_ARM * np.sin(lean) + _FOREARM * np.cos(forearm_pitch) + _WRIST_TO_GRASP * np.cos(pitch)
    height = _UPPER_ARM * np.cos(lean) - _FOREARM * np.sin(forearm_pitch) - _WRIST_TO_GRASP * np.sin(pitch)
    base_x, base_y, facing = _BASES[arm]
    return np.array(
        [
            base_x + facing * radius * np.cos(waist),
            base_y + facing * radius * np.sin(waist),
            _SHOULDER_HEIGHT + height,
            pitch,
            roll,
        ]
    )


def bearing(arm: Arm, x: float, y: float) -> float:
    """Waist angle [rad] at which the arm faces the point.

    A vertical tool rolled by this angle opens its fingers along world y, whatever the waist does.
    """
    base_x, base_y, facing = _BASES[arm]
    return float(np.arctan2(facing * (y - base_y), facing * (x - base_x)))


def _check_reach(arm: Arm, tool: np.ndarray, reached: np.ndarray) -> None:
    if not reached.all():
        x, y, z = tool[int(np.argmin(reached)), :3].round(3).tolist()
        raise ConfigurationError(
            f"the {arm} arm cannot reach x={x} y={y} z={z} m; place objects where gym-aloha does"
        )
