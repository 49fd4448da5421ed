"""When an episode counts as a success: gym-aloha's touch, and a hold that a mere touch cannot satisfy."""

from collections.abc import Callable
from functools import partial

from lerobot_act_chunking.envs.aloha import rewards
from lerobot_act_chunking.envs.aloha.instructions import Goal
from lerobot_act_chunking.envs.aloha.rewards import PEG, PIN, SOCKET_WALLS, TABLE, Contacts
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


class HandOverRule(SuccessRule):
    """Counts only once the giving arm has held the cube in the air: to pick it up is not to be handed it.

    Args:
        condition: what must hold of the touching geoms.
        steps: for how many consecutive control steps.
        goal: which cube is to be handed to which arm.
    """

    def __init__(self, condition: Callable[[Contacts], bool], steps: int, goal: Goal) -> None:
        self._giving = Goal(goal.colour, goal.giver)
        super().__init__(condition, steps)

    def reset(self) -> None:
        """Start a new episode."""
        super().reset()
        self._given = False

    def update(self, contacts: Contacts) -> bool:
        """Take in one control step's contacts; whether the episode has succeeded by now."""
        self._given = self._given or cube_held(contacts, self._giving)
        return super().update(contacts) if self._given else False


def make_success_rule(name: str, task: str, goal: Goal = Goal()) -> SuccessRule:  # noqa: B008 (it is frozen)
    """The rule ``touch`` (gym-aloha's reward 4 at any step) or ``hold`` (see ``cube_held``, ``peg_held``).

    Args:
        name: of the rule.
        task: one of ``TASKS``.
        goal: which cube is to be handed to which arm.

    Raises:
        ConfigurationError: unknown rule or task.
    """
    reward = make_reward(task, goal)
    rule = partial(HandOverRule, goal=goal) if get_task(task).cubes else SuccessRule
    if name == "touch":
        return rule(lambda contacts: reward(contacts) == rewards.MAX_REWARD, steps=1)
    if name == "hold":
        held = peg_held if task == "insertion" else partial(cube_held, goal=goal)
        return rule(held, steps=HOLD_STEPS)
    raise unknown_choice("success rule", name, SUCCESS_RULES)


def make_reward(task: str, goal: Goal = Goal()) -> Callable[[Contacts], int]:  # noqa: B008 (it is frozen)
    """gym-aloha's reward of a task, 0 .. 4, for the cube and the arm of ``goal`` if it has several."""
    reward = get_task(task).reward
    return partial(reward, goal=goal) if get_task(task).cubes else reward


def cube_held(contacts: Contacts, goal: Goal = Goal()) -> bool:  # noqa: B008 (it is frozen)
    """The taking fingers hold the cube and nothing but their arm touches it, so it is off the table."""
    geoms = touching(contacts, {goal.geom})
    return bool(geoms & FINGERS[goal.taker]) and all(
        geom.startswith(f"vx300s_{goal.taker}/") for geom in geoms
    )


def peg_held(contacts: Contacts) -> bool:
    """The peg touches the pin; right fingers hold the peg, left fingers the socket, both off the table."""
    peg, socket = touching(contacts, {PEG}), touching(contacts, SOCKET)
    held = bool(peg & FINGERS["right"]) and bool(socket & FINGERS["left"])
    return held and PIN in peg and TABLE not in peg | socket


def touching(contacts: Contacts, parts: set[str]) -> set[str]:
    """Names of the other geoms that touch any geom of the object made of ``parts``."""
    return {b if a in parts else a for a, b in contacts if (a in parts) != (b in parts)}
