"""Scripts of two arms, and what changes when a grasp is missed or one arm waits for the other."""

from dataclasses import dataclass, replace

import numpy as np

from lerobot_act_chunking.envs.strokes import ArmScript, delayed, miss_grasp

_CENTRE_Y = 0.5  # [m] of the cell; both arms stand on this line
_MISSED_BY = 0.06  # height [m] above the object at which fingers close that miss it
_RETRY = 1.2  # [s] from a missed grasp to the next
_HEAD_START = 1.85  # [s] by which one arm begins before the other: until it has grasped
_MEETING = 2.9  # [s] from which on the arms move to each other


@dataclass(frozen=True)
class Script:
    """Both arms over one episode.

    Attributes:
        duration: length [s] at nominal pace.
        pauses: moments [s] at which a dwell is inserted.
        pauses_after: moments [s] right after a contact, or before two parts meet.
        leading_arm: the arm that closes its fingers on nothing if a grasp is missed, and that goes first if
            one arm moves after the other.
    """

    left: ArmScript
    right: ArmScript
    duration: float
    pauses: tuple[float, ...]
    pauses_after: tuple[float, ...] = ()
    leading_arm: str = "right"

    @property
    def waiting_arm(self) -> str:
        """The arm that does not lead."""
        return "left" if self.leading_arm == "right" else "right"

    @property
    def leading(self) -> ArmScript:
        """The script of the leading arm."""
        return self.right if self.leading_arm == "right" else self.left

    @property
    def waiting(self) -> ArmScript:
        """The script of the other arm."""
        return self.left if self.leading_arm == "right" else self.right

    @property
    def beginning(self) -> float:
        """When [s] the first stroke begins; before 0, where an episode without a rest joins it."""
        return min(stroke.start for arm in (self.left, self.right) for stroke in (*arm.tool, *arm.gripper))

    @property
    def end(self) -> float:
        """When [s] the last stroke has ended, past the ``duration`` of an episode without a rest."""
        return max(stroke.end for arm in (self.left, self.right) for stroke in (*arm.tool, *arm.gripper))


def miss_first_grasp(script: Script) -> Script:
    """The script whose ``leading_arm`` closes its fingers above the object, opens them, and then grasps.

    What begins after the grasp, of both arms, comes ``_RETRY`` later.
    """
    missed = miss_grasp(script.leading, height=_MISSED_BY, retry=_RETRY)
    waiting = delayed(script.waiting, _RETRY, script.leading.tool[1].end - 0.1)
    return _delayed(script, {script.leading_arm: missed, script.waiting_arm: waiting}, _RETRY, 0.0)


def one_arm_after_the_other(script: Script) -> Script:
    """The script in which the other arm begins only when the ``leading_arm`` has grasped.

    The leading arm waits for it before the two meet.
    """
    leading = delayed(script.leading, _HEAD_START, _MEETING)
    waiting = delayed(script.waiting, _HEAD_START, -np.inf)
    arms = {script.leading_arm: leading, script.waiting_arm: waiting}
    return _delayed(script, arms, _HEAD_START, _MEETING)


def turned_pose(pose: np.ndarray) -> np.ndarray:
    """Where an object is (7,) in the cell turned by half, in which each arm stands in the other's place."""
    x, y = pose[:2]
    return np.array([-x, 2 * _CENTRE_Y - y, *pose[2:]])


def turned(script: Script) -> Script:
    """The script in the turned cell: the arms change their parts."""

    def arm(of: ArmScript) -> ArmScript:
        return replace(of, tool=tuple(replace(each, target=_turned(each.target)) for each in of.tool))

    return replace(script, left=arm(script.right), right=arm(script.left), leading_arm=script.waiting_arm)


def _turned(target: tuple[float, ...]) -> tuple[float, ...]:
    x, y, *rest = target
    return (-x, 2 * _CENTRE_Y - y, *rest)


def _delayed(script: Script, arms: dict[str, ArmScript], delay: float, after: float) -> Script:
    """The script with these arms, and what comes ``after`` [s] later by ``delay`` [s]."""

    def later(moments: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(moment + delay if moment >= after else moment for moment in moments)

    return replace(
        script,
        **arms,
        duration=script.duration + delay,
        pauses=later(script.pauses),
        pauses_after=later(script.pauses_after),
    )
