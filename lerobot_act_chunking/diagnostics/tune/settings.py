"""What is asked: of which checkpoint, measured by what, and for how long."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lerobot_act_chunking.diagnostics.core.environments import check_task
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.number_checks import check_at_least, check_positive

FIRST_SEED = 100_000
"""Of the episodes; those of later evaluations usually begin at 1000 and stay unseen."""


@dataclass(frozen=True)
class Settings:
    """What to tune, by exactly one of a task, an environment or a dataset.

    Attributes:
        checkpoint: folder or repo id, of any policy type.
        task: a simulated task of this package.
        success: its success rule; by default the first.
        env_type: any environment that LeRobot can make, by its name.
        env_arguments: fields of its configuration.
        dataset: a LeRobotDataset's folder, to replay where there is no environment.
        episodes: the most per candidate; of a dataset, how many to hold out, from the last one backwards.
        minutes: no episodes are begun after this time.
        seed: of the first episode.
        workers: processes that run episodes.
        output_dir: where finished episodes are kept; by default a folder that follows from the question.
        write: change the checkpoint's configuration to the choice.

    Raises:
        ConfigurationError: nothing to measure by, several things, or numbers that make no sense.
    """

    checkpoint: str
    task: str | None = None
    success: str | None = None
    env_type: str | None = None
    env_arguments: Mapping[str, Any] = field(default_factory=dict)
    dataset: str | None = None
    episodes: int = 100
    minutes: float = 5.0
    seed: int = FIRST_SEED
    workers: int = 1
    output_dir: Path | None = None
    write: bool = False

    def __post_init__(self) -> None:
        given = {"--task": self.task, "--env-type": self.env_type, "--dataset": self.dataset}
        named = [name for name, value in given.items() if value is not None]
        if len(named) != 1:
            raise ConfigurationError(
                f"tune measures by --task, --env-type or --dataset, got {' and '.join(named) or 'none'}: "
                "give --task (as insertion or FetchPush-v4), --env-type (of LeRobot or a plug-in), or, "
                "without a simulation, --dataset <folder>"
            )
        if self.task is not None:
            check_task(self.task)
        elif self.success is not None:
            raise ConfigurationError(
                f"--success={self.success} is a rule of the tasks of --task: leave it out, or give --task"
            )
        if self.env_arguments and self.env_type is None:
            raise ConfigurationError(
                f"--env-arg {next(iter(self.env_arguments))}=... belongs to --env-type: give both, or neither"
            )
        check_at_least(1, episodes=self.episodes, workers=self.workers)
        check_at_least(0, seed=self.seed)
        check_positive(minutes=self.minutes)
