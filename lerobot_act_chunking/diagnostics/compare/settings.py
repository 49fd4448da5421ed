"""What is asked: which evaluations, of which policies."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from lerobot_act_chunking.diagnostics.core.eval_info import EVAL_INFO
from lerobot_act_chunking.errors import ConfigurationError

EXAMPLE = "act=outputs/eval/act diffusion=outputs/eval/diffusion"


@dataclass(frozen=True)
class Recipe:
    """A policy by its evaluations.

    Attributes:
        name: as reports call it.
        evaluations: an ``eval_info.json`` for each training seed; one where there was one training.
    """

    name: str
    evaluations: tuple[Path, ...]


@dataclass(frozen=True)
class Settings:
    """What to compare.

    Attributes:
        recipes: two or more policies.
        paired: whether episode i began alike in all evaluations, as with one ``--seed`` of ``lerobot-eval``.

    Raises:
        ConfigurationError: fewer than two recipes, a name or an evaluation that comes twice, or several
            training seeds of some recipes and one of others.
    """

    recipes: tuple[Recipe, ...]
    paired: bool = True

    def __post_init__(self) -> None:
        if len(self.recipes) < 2:
            raise ConfigurationError(f"compare takes two policies or more: {EXAMPLE}")
        for value, count in Counter(each.name for each in self.recipes).items():
            if count > 1:
                raise ConfigurationError(
                    f"{count} policies are named {value}: give other names (a=..., b=...), or all training "
                    f"seeds of one policy together: {value}=first,second"
                )
        seeds = {each.name: len(each.evaluations) for each in self.recipes}
        if min(seeds.values()) == 1 < max(seeds.values()):
            counts = ", ".join(f"{name} {count}" for name, count in seeds.items())
            raise ConfigurationError(
                f"training seeds: {counts}. How much they differ is known of some only: give each two or "
                "more, or each one"
            )
        paths = Counter(path.resolve() for each in self.recipes for path in each.evaluations)
        for path, count in paths.items():
            if count > 1:
                raise ConfigurationError(f"{path} is given {count} times: every evaluation counts once")


def parse_recipe(text: str) -> Recipe:
    """A policy of the command line: ``NAME=PATH[,PATH...]``, or a path alone, whose folder is its name.

    Raises:
        ConfigurationError: no name or no path.
    """
    name, equals, rest = text.partition("=")
    places = [Path(each) for each in (rest if equals else text).split(",") if each]
    if not places or (equals and not name):
        raise ConfigurationError(f"{text!r} is no evaluation: give NAME=PATH, such as {EXAMPLE}")
    evaluations = tuple(place / EVAL_INFO if place.suffix != ".json" else place for place in places)
    return Recipe(name if equals else evaluations[0].parent.name, evaluations)
