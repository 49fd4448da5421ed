"""What is asked: of which checkpoint, measured by what, and for how long."""

from dataclasses import dataclass
from pathlib import Path

from act_chunking_runtime.number_checks import check_at_least, check_positive
from lerobot_act_chunking.diagnostics.core.environments import EnvironmentSpec
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.executors import Cluster

FIRST_SEED = 100_000
"""Of the episodes; those of later evaluations usually begin at 1000 and stay unseen."""


@dataclass(frozen=True)
class Settings:
    """What to tune, by either an environment or a dataset.

    Attributes:
        checkpoint: folder or repo id, of any policy type.
        environment: to measure success in.
        dataset: a LeRobotDataset's folder, to replay where there is no environment.
        episodes: the most per candidate; of a dataset, how many to hold out, from the last one backwards.
        minutes: no episodes are begun after this time.
        seed: of the first episode.
        workers: processes that run episodes.
        cluster: whose; by default this machine's.
        output_dir: where finished episodes are kept; by default a folder that follows from the question.
        write: change the checkpoint's configuration to the choice.

    Raises:
        ConfigurationError: nothing to measure by, two things, or numbers that make no sense.
    """

    checkpoint: str
    environment: EnvironmentSpec | None = None
    dataset: str | None = None
    episodes: int = 100
    minutes: float = 5.0
    seed: int = FIRST_SEED
    workers: int = 1
    cluster: Cluster | None = None
    output_dir: Path | None = None
    write: bool = False

    def __post_init__(self) -> None:
        if (self.environment is None) == (self.dataset is None):
            got = "none" if self.dataset is None else "both"
            raise ConfigurationError(
                f"tune measures in an environment or by a dataset, got {got}: give --task (as insertion or "
                "FetchPush-v4), --env.type (of LeRobot or a plug-in), or, without a simulation, "
                "--dataset <folder>"
            )
        check_at_least(1, episodes=self.episodes, workers=self.workers)
        check_at_least(0, seed=self.seed)
        check_positive(minutes=self.minutes)
