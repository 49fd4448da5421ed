"""When an episode counts as a success: gym-aloha's touch, and a hold that a mere touch cannot satisfy."""

from collections.abc import Callable

from lerobot_act_chunking.envs.aloha import rewards
from lerobot_act_chunking.envs.aloha.rewards import CUBE, PEG, PIN, SOCKET_WALLS, TABLE, Contacts
from lerobot_act_chunking.envs.aloha.tasks import get_task
from lerobot_act_chunking.errors import unknown_choice

SUCCESS_RULES = ("touch", "hold")

HOLD_STEPS = 10
"""Consecutive control steps (0.2 s) a hold must last."""

FINGERS = {
    arm: {f"vx300s_{arm}/10_{side}_gripper_finger" for side in ("left", "right")} for arm in ("left", "right")
}
"""The geoms of each arm's fingers."""
SOCKET = {*SOCKET_WALLS, PIN}
"""The geoms of the socket."""


class SuccessRule:
    """Succeeds once a condition on the contacts has held for ``steps`` control steps in a row, and stays so.

    Args:
        condition: what must hold of the touching geoms.
        steps: for how many consecutive control steps.
    """

    def __init__(self, condition: Callable[[Contacts], bool], steps: int) -> None:
        self._condition = condition
        self._steps = steps
        self.reset()

    def reset(self) -> None:
        """Start a new episode."""
        self._streak = 0
        self.succeeded = False

    def update(self, contacts: Contacts) -> bool:
        """Take in one control step's contacts; whether the episode has succeeded by now."""
        self._streak = self._streak + 1 if self._condition(contacts) else 0
        self.succeeded = self.succeeded or self._streak >= self._steps
        return self.succeeded


def make_success_rule(name: str, task: str) -> SuccessRule:
    """The rule ``touch`` (gym-aloha's reward 4 at any step) or ``hold`` (see ``cube_held``, ``peg_held``).

    Raises:
        ConfigurationError: unknown rule or task.
    """
    reward = get_task(task).reward
    if name == "touch":
        return SuccessRule(lambda contacts: reward(contacts) == rewards.MAX_REWARD, steps=1)
    if name == "hold":
        return SuccessRule(peg_held if task == "insertion" else cube_held, steps=HOLD_STEPS)
    raise unknown_choice("success rule", name, SUCCESS_RULES)


def cube_held(contacts: Contacts) -> bool:
    """The left fingers hold the cube and nothing but the left arm touches it, so it is off the table."""
    geoms = touching(contacts, {CUBE})
    return bool(geoms & FINGERS["left"]) and all(geom.startswith("vx300s_left/") for geom in geoms)


def peg_held(contacts: Contacts) -> bool:
    """The peg touches the pin; right fingers hold the peg, left fingers the socket, both off the table."""
    peg, socket = touching(contacts, {PEG}), touching(contacts, SOCKET)
    held = bool(peg & FINGERS["right"]) and bool(socket & FINGERS["left"])
    return held and PIN in peg and TABLE not in peg | socket


def touching(contacts: Contacts, parts: set[str]) -> set[str]:
    """Names of the other geoms that touch any geom of the object made of ``parts``."""
    return {b if a in parts else a for a, b in contacts if (a in parts) != (b in parts)}
