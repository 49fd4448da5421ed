"""Policies as a command line names them: by a name, and where each training of it lies."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from lerobot_act_chunking.errors import ConfigurationError


@dataclass(frozen=True)
class Recipe:
    """A policy that was trained once, or several times with different training seeds.

    Attributes:
        name: as reports call it.
        places: a folder or file for each training.
    """

    name: str
    places: tuple[str, ...]


def parse_recipe(text: str, what: str, example: str) -> tuple[str | None, tuple[str, ...]]:
    """A name and places of ``NAME=PLACE[,PLACE...]``; no name for a place alone.

    Args:
        text: of the command line.
        what: a place is, for the message.
        example: of what to give.

    Raises:
        ConfigurationError: no name before the sign, or no place.
    """
    name, equals, rest = text.partition("=")
    places = tuple(each for each in (rest if equals else text).split(",") if each)
    if not places or (equals and not name):
        raise ConfigurationError(f"{text!r} is no {what}: give NAME=PATH, such as {example}")
    return (name if equals else None), places


def check_names(recipes: Sequence[Recipe]) -> None:
    """Refuse a name that comes twice.

    Raises:
        ConfigurationError: naming it, and both ways out.
    """
    for value, count in Counter(each.name for each in recipes).items():
        if count > 1:
            raise ConfigurationError(
                f"{count} policies are named {value}: give other names (a=..., b=...), or all training "
                f"seeds of one policy together: {value}=first,second"
            )
