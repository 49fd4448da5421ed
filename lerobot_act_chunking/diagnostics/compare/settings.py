"""What is asked: which evaluations, of which policies."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from lerobot_act_chunking.diagnostics.core.eval_info import EVAL_INFO
from lerobot_act_chunking.diagnostics.core.recipes import Recipe, check_names, parse_recipe
from lerobot_act_chunking.errors import ConfigurationError

EXAMPLE = "act=outputs/eval/act diffusion=outputs/eval/diffusion"


@dataclass(frozen=True)
class Settings:
    """What to compare.

    Attributes:
        recipes: two or more policies, each by an ``eval_info.json`` for every training seed.
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
        check_names(self.recipes)
        seeds = {each.name: len(each.places) for each in self.recipes}
        if min(seeds.values()) == 1 < max(seeds.values()):
            counts = ", ".join(f"{name} {count}" for name, count in seeds.items())
            raise ConfigurationError(
                f"training seeds: {counts}. How much they differ is known of some only: give each two or "
                "more, or each one"
            )
        paths = Counter(Path(place).resolve() for each in self.recipes for place in each.places)
        for path, count in paths.items():
            if count > 1:
                raise ConfigurationError(f"{path} is given {count} times: every evaluation counts once")


def parse_policy(text: str) -> Recipe:
    """A policy of the command line: ``NAME=PATH[,PATH...]``, or a path alone, whose folder is its name.

    Raises:
        ConfigurationError: no name or no path.
    """
    name, places = parse_recipe(text, "evaluation", EXAMPLE)
    files = [Path(each) / EVAL_INFO if Path(each).suffix != ".json" else Path(each) for each in places]
    return Recipe(name or files[0].parent.name, tuple(map(str, files)))
