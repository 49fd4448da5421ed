"""What is asked: which policies, in which environment, for how many episodes."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from act_chunking_runtime.number_checks import check_at_least
from lerobot_act_chunking.diagnostics.core.environments import EnvironmentSpec
from lerobot_act_chunking.diagnostics.core.eval_info import EVAL_INFO
from lerobot_act_chunking.diagnostics.core.recipes import Recipe, check_names, parse_recipe
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.executors import Cluster

FIRST_SEED = 1000  # lerobot-eval's
EXAMPLE = "act=outputs/train/act/checkpoints/last/pretrained_model"


@dataclass(frozen=True)
class Shard:
    """A part of the episodes, so that several machines can share an evaluation.

    Attributes:
        number: which part, from 1 on.
        of: how many parts there are.
    """

    number: int = 1
    of: int = 1

    def __post_init__(self) -> None:
        if not 1 <= self.number <= self.of:
            raise ConfigurationError(
                f"--shard={self.number}/{self.of}: give 1/{self.of} to {self.of}/{self.of}"
            )


@dataclass(frozen=True)
class Settings:
    """What to evaluate.

    Attributes:
        recipes: one policy or more, each with a checkpoint for every training seed.
        environment: where.
        episodes: how many; with ``until_decided`` the most.
        seed: of the first episode; the others follow.
        batch_size: episodes that act together, as ``--eval.batch_size`` of ``lerobot-eval``.
        draws: how often a policy that samples repeats every episode, each time with other noise.
        workers: processes.
        cluster: whose; by default this machine's.
        output_dir: where everything is kept; by default a folder that follows from the question.
        shard: the part to do here.
        merge: folders of other parts, whose episodes are taken over.
        until_decided: end as soon as it is known which policy is better.
        videos: films of so many episodes of each checkpoint, failures first.

    Raises:
        ConfigurationError: no policy, a name or checkpoint that comes twice, or numbers that make no sense.
    """

    recipes: tuple[Recipe, ...]
    environment: EnvironmentSpec
    episodes: int = 200
    seed: int = FIRST_SEED
    batch_size: int = 25
    draws: int = 1
    workers: int = 1
    cluster: Cluster | None = None
    output_dir: Path | None = None
    shard: Shard = Shard()
    merge: tuple[Path, ...] = ()
    until_decided: bool = False
    videos: int = 0

    def __post_init__(self) -> None:
        check_at_least(
            1, episodes=self.episodes, batch_size=self.batch_size, draws=self.draws, workers=self.workers
        )
        check_at_least(0, seed=self.seed, videos=self.videos)
        if not self.recipes:
            raise ConfigurationError(f"eval takes a checkpoint or more: {EXAMPLE}")
        check_names(self.recipes)
        for place, count in Counter(place for each in self.recipes for place in each.places).items():
            if count > 1:
                raise ConfigurationError(f"{place} is given {count} times: every training counts once")
        if not self.groups:
            whole = -(-self.episodes // self.batch_size)
            raise ConfigurationError(
                f"--shard={self.shard.number}/{self.shard.of} has no episode: {self.episodes} episodes are "
                f"{whole} groups of --batch-size={self.batch_size}; share them out among {whole} at most"
            )
        if self.until_decided:
            self._check_can_be_decided()

    @property
    def groups(self) -> list[int]:
        """The numbers of the groups of episodes that are run here."""
        every = range(-(-self.episodes // self.batch_size))
        return [number for number in every if number % self.shard.of == self.shard.number - 1]

    def _check_can_be_decided(self) -> None:
        if len(self.recipes) < 2:
            raise ConfigurationError("--until=decided compares policies: give two or more")
        several = [each.name for each in self.recipes if len(each.places) > 1]
        if several:
            raise ConfigurationError(
                f"--until=decided is about checkpoints, and {', '.join(several)} has several training seeds: "
                "more episodes do not show how much trainings differ; give a fixed --episodes"
            )
        if self.draws > 1:
            raise ConfigurationError("--until=decided counts every episode once: leave out --draws")
        if self.shard.of > 1:
            raise ConfigurationError(
                "--until=decided looks at all episodes so far: leave out --shard, or give a fixed --episodes"
            )


def parse_shard(text: str) -> Shard:
    """A part of the episodes, as ``2/4``.

    Raises:
        ConfigurationError: no two numbers, or no part that there is.
    """
    number, _, of = text.partition("/")
    try:
        return Shard(int(number), int(of))
    except ValueError:
        raise ConfigurationError(f"--shard={text} must be a part and their number, as 2/4") from None


def parse_policy(text: str) -> Recipe:
    """A policy of the command line: ``NAME=CHECKPOINT[,CHECKPOINT...]``, or a checkpoint alone.

    Raises:
        ConfigurationError: no name, no checkpoint, or the ``eval_info.json`` of an evaluation.
    """
    name, places = parse_recipe(text, "checkpoint", EXAMPLE)
    for place in places:
        if PurePosixPath(place).name == EVAL_INFO:
            raise ConfigurationError(
                f"{place} is of an evaluation that is done, and eval takes checkpoints: act-chunking compare "
                "reads it"
            )
    return Recipe(name or name_of(places[0]), places)


def name_of(checkpoint: str) -> str:
    """The name of the training's folder, and the step if it is not the last one.

    ``outputs/train/act/checkpoints/last/pretrained_model`` is ``act``.
    """
    *folders, name = [each for each in PurePosixPath(checkpoint).parts if each != "pretrained_model"] or [""]
    if folders and folders[-1] == "checkpoints":
        run = folders[-2] if len(folders) > 1 else "checkpoint"
        return run if name == "last" else f"{run}-{name}"
    return name
