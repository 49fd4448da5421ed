"""What is asked: which cells, on which demonstrations, in which environment, at what cost."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from act_chunking_runtime.number_checks import check_at_least, check_positive
from lerobot_act_chunking.diagnostics.core.environments import EnvironmentSpec
from lerobot_act_chunking.diagnostics.lm_ablation.cells import CELLS, Cell
from lerobot_act_chunking.errors import ConfigurationError, look_up

FIRST_SEED = 1000  # lerobot-eval's
OURS = ("encoder_impl", "encoder_init", "encoder_weights", "encoder_training", "encoder_vocabulary")
"""Fields in which the cells differ, or that follow from the dataset."""


@dataclass(frozen=True)
class Budget:
    """What each training costs.

    Attributes:
        steps: of each training.
        batch_size: of each step.
        looks: how often the validation loss is measured.
        episodes: of each trained policy, under each condition.
        pretraining_steps: of each encoder that is pretrained here, with batches of 16.
    """

    steps: int = 1500
    batch_size: int = 16
    looks: int = 10
    episodes: int = 100
    pretraining_steps: int = 2000

    def __post_init__(self) -> None:
        check_at_least(1, **vars(self))
        if self.looks > self.steps:
            raise ConfigurationError(f"looks={self.looks} are more than there are steps ({self.steps})")


@dataclass(frozen=True)
class Thresholds:
    """When to worry.

    Attributes:
        parameters: largest mismatch of the two architectures' weights, as a share.
        flops: largest mismatch of their work, as a share.
        loss_share: validation loss that counts as learned, as a share of the one before training.
    """

    parameters: float = 0.02
    flops: float = 0.1
    loss_share: float = 0.3

    def __post_init__(self) -> None:
        check_positive(**vars(self))


@dataclass(frozen=True)
class Settings:
    """What to compare.

    Attributes:
        dataset: folder of a LeRobotDataset.
        environment: where policies act.
        output_dir: where every training is written down; a run goes on where it was.
        shifts: further conditions, each a field of the environment and its value, as ``instructions=words``.
        cells: what is trained here.
        seeds: of the trainings.
        sizes: numbers of demonstrations.
        held_out: the dataset's last episodes, for the validation loss.
        language_model: folder of a BERT-like model; None for MiniLM's package.
        text_tokens: word pieces of the longest instruction.
        policy: further fields of ``act_chunked``.
        budget: what each training costs.
        seed: of the first episode.
        thresholds: when to worry.

    Raises:
        ConfigurationError: an unknown cell, a field that the cells decide, or numbers that make no sense.
    """

    dataset: str
    environment: EnvironmentSpec
    output_dir: Path
    shifts: tuple[str, ...] = ()
    cells: tuple[str, ...] = tuple(CELLS)
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)
    sizes: tuple[int, ...] = (5, 10, 25, 50)
    held_out: int = 10
    language_model: str | None = None
    text_tokens: int = 16
    policy: Mapping[str, Any] = field(default_factory=dict)
    budget: Budget = field(default_factory=Budget)
    seed: int = FIRST_SEED
    thresholds: Thresholds = field(default_factory=Thresholds)

    def __post_init__(self) -> None:
        check_at_least(0, seed=self.seed, **{f"seeds={each}": each for each in self.seeds})
        check_at_least(1, held_out=self.held_out, **{f"sizes={each}": each for each in self.sizes})
        check_at_least(3, text_tokens=self.text_tokens)
        for name in self.cells:
            look_up("cell", name, CELLS)
        for name in self.policy:
            if name in OURS:
                raise ConfigurationError(f"--policy.{name} is what the cells differ in: leave it out")
        if not (self.cells and self.seeds and self.sizes):
            raise ConfigurationError("give one cell, one training seed and one size at least")
        for each in self.shifts:
            if "=" not in each:
                raise ConfigurationError(f"--shift={each} must be a field of the environment and its value")

    @property
    def chosen(self) -> list[Cell]:
        """The cells, in the order of the table."""
        return [cell for name, cell in CELLS.items() if name in self.cells]

    @property
    def conditions(self) -> dict[str, EnvironmentSpec]:
        """The environments by name; the one that is asked for first."""
        import yaml

        found = {"as demonstrated": self.environment}
        for each in self.shifts:
            name, _, value = each.partition("=")
            arguments = {**self.environment.arguments, name: yaml.safe_load(value)}
            found[each] = replace(self.environment, arguments=arguments)
        return found


def parse_names(text: str | None, otherwise: Sequence[str]) -> tuple[str, ...]:
    """Names with commas between them; ``otherwise`` where nothing is given."""
    return tuple(each.strip() for each in text.split(",") if each.strip()) if text else tuple(otherwise)
