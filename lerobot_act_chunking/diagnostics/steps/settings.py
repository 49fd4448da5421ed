"""What is asked: of which policy, on which observations, how precisely."""

from dataclasses import dataclass

from lerobot_act_chunking.diagnostics.core.environments import EnvironmentSpec
from lerobot_act_chunking.diagnostics.core.measures import Measure
from lerobot_act_chunking.errors import ConfigurationError

DEFAULT_TOLERANCE_MM = 0.5


@dataclass(frozen=True)
class Settings:
    """What to diagnose.

    Attributes:
        checkpoint: a `diffusion_chunked` checkpoint.
        dataset: a LeRobotDataset's folder; None for the one it was trained on.
        episodes: how many to hold out, from the last one backwards.
        observations: how many to take from them.
        tolerance: differences that do not matter; None for half a millimetre where actions are ALOHA's.
        samplers: which to sweep; all by default.
        steps: step counts; `grid.STEPS` by default.
        seed: of the noise.
        environment: to run by number of steps, too; None for none.
        success_seeds: episodes in it per number of steps.
    """

    checkpoint: str
    dataset: str | None = None
    episodes: int = 10
    observations: int = 256
    tolerance: float | None = None
    samplers: tuple[str, ...] = ()
    steps: tuple[int, ...] = ()
    seed: int = 0
    environment: EnvironmentSpec | None = None
    success_seeds: int = 50


def tolerance_of(requested: float | None, measure: Measure) -> float:
    """The tolerance asked for, or half a millimetre.

    Raises:
        ConfigurationError: it is needed, because there are no millimetres.
    """
    if requested is not None:
        return requested
    if measure.unit != "mm":
        raise ConfigurationError(
            "these actions are not ALOHA's 14 joints, so there is no distance in millimetres: say with "
            "--tolerance how much of a difference in raw action units does not matter"
        )
    return DEFAULT_TOLERANCE_MM
