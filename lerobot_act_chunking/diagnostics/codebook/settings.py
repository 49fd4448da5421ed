"""What is asked: about which tokenizer or dataset, and when to worry."""

from dataclasses import asdict, dataclass, field
from typing import Any, Self

from lerobot_act_chunking.data.actions import is_dataset
from lerobot_act_chunking.errors import ConfigurationError


@dataclass(frozen=True)
class Thresholds:
    """Beyond the first number of a pair the verdict is warn, beyond the second fail.

    Attributes:
        dead: share of a level's codes that are never used, where codes are learned.
        lost_variance: share of the actions' variance that the codes lose.
        lost_dimension_variance: the same of a single dimension; warn only.
        distance: Jensen-Shannon distance to the training data's codes, above what chance makes; warn only.
        error_ratio: RMS error relative to that of the training data.
        beyond: share of chunks with errors that 99 % of the training chunks do not have.
    """

    dead: tuple[float, float] = (0.25, 0.5)
    lost_variance: tuple[float, float] = (0.1, 0.5)
    lost_dimension_variance: float = 0.5
    distance: float = 0.2
    error_ratio: tuple[float, float] = (1.5, 3.0)
    beyond: tuple[float, float] = (0.05, 0.2)

    def to_json(self) -> dict[str, Any]:
        """The numbers by the names that reports have for them."""
        values = asdict(self)
        values["unsaid"] = values.pop("lost_dimension_variance")
        return values

    @classmethod
    def with_max_lost(cls, share: float) -> Self:
        """The usual ones, but for the share of the variance that may be lost.

        Raises:
            ConfigurationError: it is no share.
        """
        if not 0 < share < 1:
            raise ConfigurationError(f"max_lost={share} must be between 0 and 1")
        return cls(lost_variance=(share, max(share, cls.lost_variance[1])))


@dataclass(frozen=True)
class Settings:
    """What to diagnose.

    Attributes:
        source: a vqbet_chunked checkpoint or a file of ``act-chunking train-tokenizer``: what do its codes
            do? A LeRobotDataset's folder: which tokenizer suits it?
        dataset: folder of another LeRobotDataset: do the codes still fit? Not for a dataset as the source.
        chunk_size: actions per chunk, for a dataset alone; None for the policy's default.
        chunk_stride: control steps between them, likewise.
        steps: of training, for tokenizers that learn, likewise.
        seed: of all that is random.
        thresholds: when to worry.

    Raises:
        ConfigurationError: a setting that goes with the other kind of source.
    """

    source: str
    dataset: str | None = None
    chunk_size: int | None = None
    chunk_stride: int | None = None
    steps: int = 1000
    seed: int = 0
    thresholds: Thresholds = field(default_factory=Thresholds)

    def __post_init__(self) -> None:
        if self.compares:
            _refuse({"dataset": self.dataset}, "a checkpoint or a tokenizer file, and this is a dataset")
        else:
            _refuse(self.sizes, "a dataset; these codes are for chunks of their own")

    @property
    def compares(self) -> bool:
        """Whether the source is a dataset, on which tokenizers are compared."""
        return is_dataset(self.source)

    @property
    def sizes(self) -> dict[str, int | None]:
        """The settings of a chunk by their names."""
        return {"chunk_size": self.chunk_size, "chunk_stride": self.chunk_stride}


def _refuse(options: dict[str, Any], goes_with: str) -> None:
    for name, value in options.items():
        if value is not None:
            raise ConfigurationError(f"--{name.replace('_', '-')}={value} goes with {goes_with}")
