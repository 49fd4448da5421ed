"""How far an ALOHA episode got, from what touches what: the name of its failure, unless it succeeds."""

from collections.abc import Collection, Mapping, Sequence
from typing import Protocol

from lerobot_act_chunking.envs.aloha.instructions import Goal
from lerobot_act_chunking.envs.aloha.rewards import PEG, PIN, SOCKET_WALLS, TABLE, Contacts
from lerobot_act_chunking.envs.aloha.success import FINGERS, SOCKET
from lerobot_act_chunking.errors import unknown_choice

_HAND_OVER = (
    "no contact",  # the right gripper never touched the cube
    "missed grasp",  # it did, but the cube was never lifted
    "dropped",  # it was, and no gripper has it in the air now
    "no hand-over",  # the right fingers alone have it
    "not released",  # the fingers of both arms have it
    "unsteady hold",  # the left fingers alone have it, but not as the success rule asks
)
FAILURES: Mapping[str, tuple[str, ...]] = {
    "transfer_cube": _HAND_OVER,
    "insertion": (
        "no contact",  # no gripper touched its part
        "missed grasp",  # one did, but a part was never lifted
        "dropped",  # both were, and one is not held in the air now
        "not joined",  # both are held, and never met
        "misaligned",  # the peg met the socket's walls, never the pin
        "unsteady hold",  # it met the pin, but is not held as the success rule asks
    ),
    "transfer_modes": _HAND_OVER,
    "language_transfer": (
        "no contact",  # as above, but of the named cube and the arms that the direction names
        "wrong cube",  # the named cube was never lifted, but another one was
        *_HAND_OVER[1:],
    ),
}
"""The failures of each task, in the order of how far an episode got."""

STEADY_STEPS = 5
"""Consecutive control steps (0.1 s) after which a hold has begun or ended. While one lasts, its contacts
break for up to 2 steps in demonstrations, and for up to 4 in episodes of trained policies."""

LIFTED = 0.04
"""Height [m] over which the centre of an object that is held is lifted; at rest it is at 0.01 to 0.022. To be
off the table is not enough: fingers that close on the socket may raise it by a millimetre for a second."""

_FALLING = 0.06
"""Height [m] that a cube only leaves upwards: episodes let it fall from 0.05."""

_PALM = ("7_gripper", "8_gripper_prop", "9_gripper_bar")


class Progress(Protocol):
    """How far one episode got."""

    def update(self, contacts: Contacts, heights: Sequence[float]) -> None:
        """Take in one control step: what touches what, and the height [m] of each object's centre."""

    @property
    def failure(self) -> str:
        """What is missing, one of ``FAILURES``."""
        ...


def make_progress(task: str, goal: Goal = Goal()) -> Progress:  # noqa: B008 (it is frozen)
    """The progress of an episode that begins.

    Args:
        task: one of ``TASKS``.
        goal: which cube is to be handed to which arm.

    Raises:
        ConfigurationError: unknown task.
    """
    if task not in FAILURES:
        raise unknown_choice("task", task, FAILURES)
    return _Insertion() if task == "insertion" else _HandOver(goal)


class Hold:
    """One arm and one object: whether the gripper ever touched it, ever lifted it, and holds it in the air.

    Args:
        arm: "left" or "right".
        parts: the object's geoms.
    """

    def __init__(self, arm: str, parts: Collection[str]) -> None:
        gripper = FINGERS[arm] | {f"vx300s_{arm}/{geom}" for geom in _PALM}
        self._gripper = _pairs(gripper, parts)
        self._fingers = _pairs(FINGERS[arm], parts)
        self._table = _pairs((TABLE,), parts)
        self._streak = 0
        self.touched = self.lifted = self.holds = False

    def update(self, contacts: Contacts, height: float) -> None:
        """Take in one control step's contacts and the height [m] of the object's centre."""
        self.touched = self.touched or not contacts.isdisjoint(self._gripper)
        holds = not contacts.isdisjoint(self._fingers) and contacts.isdisjoint(self._table)
        self._streak = self._streak + 1 if holds != self.holds else 0
        if self._streak == STEADY_STEPS:
            self.holds, self._streak = holds, 0
        self.lifted = self.lifted or (self.holds and height > LIFTED)


class _HandOver:
    def __init__(self, goal: Goal) -> None:
        self._index = goal.index
        self._giver, self._taker = (Hold(arm, (goal.geom,)) for arm in (goal.giver, goal.taker))
        self._other_lifted = False

    def update(self, contacts: Contacts, heights: Sequence[float]) -> None:
        for hold in (self._giver, self._taker):
            hold.update(contacts, heights[self._index])
        others = (height for index, height in enumerate(heights) if index != self._index)
        self._other_lifted = self._other_lifted or max(others, default=0.0) > _FALLING

    @property
    def failure(self) -> str:
        if not (self._giver.lifted or self._taker.lifted):
            if self._other_lifted:
                return "wrong cube"
            return "missed grasp" if self._giver.touched else "no contact"
        if self._giver.holds:
            return "not released" if self._taker.holds else "no hand-over"
        return "unsteady hold" if self._taker.holds else "dropped"


class _Insertion:
    def __init__(self) -> None:
        self._peg, self._socket = Hold("right", (PEG,)), Hold("left", SOCKET)
        self._met = self._inserted = False

    def update(self, contacts: Contacts, heights: Sequence[float]) -> None:
        self._peg.update(contacts, heights[0])
        self._socket.update(contacts, heights[1])
        if self._peg.holds and self._socket.holds:
            self._met = self._met or not contacts.isdisjoint(_PEG_AND_WALLS)
            self._inserted = self._inserted or not contacts.isdisjoint(_PEG_AND_PIN)

    @property
    def failure(self) -> str:
        parts = (self._peg, self._socket)
        if not all(part.lifted for part in parts):
            return "missed grasp" if any(part.touched for part in parts) else "no contact"
        if not all(part.holds for part in parts):
            return "dropped"
        if self._inserted:
            return "unsteady hold"
        return "misaligned" if self._met else "not joined"


def _pairs(some: Collection[str], others: Collection[str]) -> Contacts:
    """All contacts between them; MuJoCo may name either geom first."""
    return frozenset(pair for a in some for b in others for pair in ((a, b), (b, a)))


_PEG_AND_WALLS, _PEG_AND_PIN = _pairs((PEG,), SOCKET_WALLS), _pairs((PEG,), (PIN,))
