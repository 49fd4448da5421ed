"""What is asked: of which dataset, and what its strides are held against."""

from dataclasses import dataclass, field

from act_chunking_runtime.number_checks import check_at_least, check_positive
from lerobot_act_chunking.data.actions import is_dataset
from lerobot_act_chunking.errors import ConfigurationError, DatasetError


@dataclass(frozen=True)
class Criteria:
    """What strides are tried, and held against.

    Attributes:
        horizon_s: time that a chunk covers [s].
        strides: control steps between predictions to try; none for the usual ones.
        chunk_stride: the one to judge, if any.
        tolerance: in millimetres where positions are known, else a share of each dimension's range; None for
            half a millimetre, or a hundredth.
        gripper_dims: dimensions that the policy holds between predictions.
    """

    horizon_s: float = 2.0
    strides: tuple[int, ...] = ()
    chunk_stride: int | None = None
    tolerance: float | None = None
    gripper_dims: tuple[int, ...] = ()

    def check(self, n_dims: int) -> None:
        """Refuse values that cannot work.

        Raises:
            ConfigurationError: naming the value and the way out.
        """
        check_positive(horizon_s=self.horizon_s, tolerance=self.tolerance)
        check_at_least(1, chunk_stride=self.chunk_stride, strides=min(self.strides, default=None))
        for dim in self.gripper_dims:
            if not 0 <= dim < n_dims:
                raise ConfigurationError(
                    f"gripper_dims={list(self.gripper_dims)}: {dim} is no dimension of these actions, which "
                    f"have {n_dims}, from 0"
                )


@dataclass(frozen=True)
class Settings:
    """What to diagnose.

    Attributes:
        dataset: a LeRobotDataset's folder.
        criteria: what its strides are held against.

    Raises:
        DatasetError: there is no dataset.
    """

    dataset: str
    criteria: Criteria = field(default_factory=Criteria)

    def __post_init__(self) -> None:
        if not is_dataset(self.dataset):
            raise DatasetError(
                f"there is no LeRobotDataset at {self.dataset}: give its folder (with meta/info.json)"
            )
