"""What is asked: of which dataset, and how much of its cameras is looked at."""

from dataclasses import dataclass

from lerobot_act_chunking.data.actions import require_dataset
from lerobot_act_chunking.errors import unknown_choice

CAMERAS = ("none", "sample", "all")


@dataclass(frozen=True)
class Settings:
    """What to diagnose.

    Attributes:
        dataset: a LeRobotDataset's folder.
        cameras: how much of the cameras is decoded: ``none``, a ``sample`` of the episodes, or ``all``.
        operator_column: column that says who demonstrates; None to look for one.

    Raises:
        DatasetError: there is no dataset.
        ConfigurationError: unknown ``cameras``.
    """

    dataset: str
    cameras: str = "sample"
    operator_column: str | None = None

    def __post_init__(self) -> None:
        if self.cameras not in CAMERAS:
            raise unknown_choice("cameras", self.cameras, CAMERAS)
        require_dataset(self.dataset)
