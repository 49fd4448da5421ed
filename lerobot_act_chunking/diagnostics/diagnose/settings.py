"""What is asked: of which checkpoint, in which environment, and for how long."""

from dataclasses import dataclass
from pathlib import Path

from act_chunking_runtime.number_checks import check_at_least, check_positive
from lerobot_act_chunking.diagnostics.core.environments import EnvironmentSpec
from lerobot_act_chunking.errors import ConfigurationError

FIRST_SEED = 1000  # lerobot-eval's


@dataclass(frozen=True)
class Settings:
    """What to explain.

    Attributes:
        checkpoint: folder or repo id, of any policy type.
        environment: where the policy fails; without one, what a dataset can tell is told.
        dataset: folder of demonstrations; by default those of the checkpoint's training, if they are here.
        episodes: of the policy as it is.
        most: failing episodes to intervene on; of succeeding ones, which may break, three times as many.
        minutes: no episodes are begun after this time.
        seed: of the first episode.
        batch_size: episodes that act together.
        workers: processes that run episodes.
        output_dir: where finished episodes are kept; by default a folder that follows from the question.

    Raises:
        ConfigurationError: neither environment nor dataset, or numbers that make no sense.
    """

    checkpoint: str
    environment: EnvironmentSpec | None = None
    dataset: str | None = None
    episodes: int = 100
    most: int = 40
    minutes: float = 20.0
    seed: int = FIRST_SEED
    batch_size: int = 25
    workers: int = 1
    output_dir: Path | None = None

    def __post_init__(self) -> None:
        if self.environment is None and self.dataset is None:
            raise ConfigurationError(
                "diagnose needs the environment where the policy fails (--env.type of LeRobot or a plug-in, "
                "or --task, as insertion); without a simulation give --dataset <folder of demonstrations>"
            )
        check_at_least(
            1, episodes=self.episodes, most=self.most, batch_size=self.batch_size, workers=self.workers
        )
        check_at_least(0, seed=self.seed)
        check_positive(minutes=self.minutes)
