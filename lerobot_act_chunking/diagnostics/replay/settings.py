"""What is asked: of which checkpoint, on which demonstrations."""

from dataclasses import dataclass

from act_chunking_runtime.number_checks import check_at_least
from lerobot_act_chunking.data.actions import require_dataset


@dataclass(frozen=True)
class Settings:
    """What to replay.

    Attributes:
        checkpoint: folder or repo id, of any policy type.
        dataset: a LeRobotDataset's folder.
        episodes: of it; none for those that the checkpoint's training did not use.
        observations: at which the policy is asked for a whole chunk, spread over the episodes.
        seed: of the resampling behind intervals.

    Raises:
        DatasetError: there is no dataset.
        ConfigurationError: no observations.
    """

    checkpoint: str
    dataset: str
    episodes: tuple[int, ...] = ()
    observations: int = 200
    seed: int = 0

    def __post_init__(self) -> None:
        require_dataset(self.dataset)
        check_at_least(1, observations=self.observations)
        check_at_least(0, seed=self.seed)
