"""What language_transfer is asked for: which cube, to which arm, and in which words."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

Arm = Literal["left", "right"]

COLOURS = ("red", "green", "blue")
"""The cubes, in the order of their poses."""
INSTRUCTIONS = ("seen", "unseen", "shuffled")
"""Whose words an environment uses: those that demonstrations are recorded with; those that they never are;
or the first, but of a goal drawn apart from the one that counts, so that they tell nothing."""

_SEEN = (
    "Hand the {cube} to the {to}.",
    "Pick up the {cube} with the {giver} and transfer it to the {to}.",
    "Pass the {cube} from the {giver} to the {to}.",
    "Give the {cube} to the {to}.",
    "Move the {cube} from the {giver} to the {to}.",
    "With the {giver}, pick up the {cube} and give it to the {to}.",
    "The {to} gets the {cube}.",
    "Take the {cube} with the {giver}, then hand it over to the {to}.",
    "The {to} receives the {cube} from the {giver}.",
    "The {cube} goes to the {to}.",
    "Use the {giver} to give the {cube} to the {to}.",
    "Let the {to} have the {cube}.",
)
_UNSEEN = (
    "Bring the {cube} over to the {to}.",
    "Please put the {cube} into the {to}.",
    "I want the {to} to hold the {cube}.",
    "The {giver} grasps the {cube} and hands it over to the {to}.",
    "Deliver the {cube} to the {to}.",
    "Let the {to} take over the {cube} from the {giver}.",
)
_SEEN_NOUNS = ("cube", "block"), ("arm", "hand")
_UNSEEN_NOUNS = ("cube", "box"), ("arm", "gripper")


@dataclass(frozen=True)
class Goal:
    """One of the things that may be asked for.

    Attributes:
        colour: of the cube, one of ``COLOURS``.
        taker: the arm that it is handed to.
    """

    colour: str = "red"
    taker: Arm = "left"

    @property
    def giver(self) -> Arm:
        """The arm that picks it up."""
        return "right" if self.taker == "left" else "left"

    @property
    def index(self) -> int:
        """The cube's place among the poses."""
        return COLOURS.index(self.colour)

    @property
    def geom(self) -> str:
        """The cube's geom."""
        return f"{self.colour}_box"


GOALS = tuple(Goal(colour, taker) for colour in COLOURS for taker in ("left", "right"))
"""All that may be asked for."""


def phrases(goal: Goal, instructions: str) -> tuple[str, ...]:
    """Every way of asking for it, of one kind of ``INSTRUCTIONS``."""
    templates, (things, hands) = (
        (_UNSEEN, _UNSEEN_NOUNS) if instructions == "unseen" else (_SEEN, _SEEN_NOUNS)
    )
    return tuple(
        template.format(
            cube=f"{goal.colour} {thing}", giver=f"{goal.giver} {hand}", to=f"{goal.taker} {hand}"
        )
        for template in templates
        for thing in things
        for hand in hands
    )


def draw_goal(rng: np.random.Generator) -> Goal:
    """What an episode is about, each goal as often as the others."""
    return GOALS[rng.integers(len(GOALS))]


def draw_phrase(goal: Goal, instructions: str, rng: np.random.Generator) -> str:
    """How it is asked for."""
    told = draw_goal(rng) if instructions == "shuffled" else goal
    ways = phrases(told, instructions)
    return ways[rng.integers(len(ways))]
