"""What is asked: of which policy, in which environment, how often, and when to worry."""

import math
from dataclasses import dataclass, field

from act_chunking_runtime.number_checks import check_at_least
from lerobot_act_chunking.diagnostics.core.environments import EnvironmentSpec
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.executors import Cluster

FIRST_SEED = 20_000
"""Of the first episode: others than those that evaluations usually choose checkpoints by."""


@dataclass(frozen=True)
class Thresholds:
    """When to worry.

    Attributes:
        covered: a way counts as taken from this share of its demonstrated share on.
        invalid: share of episodes, or of chunks, that may go no demonstrated way.
        expected: episodes of the rarest way that there should be; with fewer nothing is said.
        reconstructed: share of a way's demonstrations that the decoder must bring back to it.
        collapsed: divergence [nats] below which a latent says nothing.
        switched: share of episodes that change their way from which on that explains a failure.
    """

    covered: float = 0.25
    invalid: float = 0.05
    expected: float = 5.0
    reconstructed: float = 0.5
    collapsed: float = 0.05
    switched: float = 0.2


@dataclass(frozen=True)
class Settings:
    """What to diagnose.

    Attributes:
        checkpoint: of any LeRobot policy: folder or repo id.
        environment: where it acts.
        dataset: a LeRobotDataset's folder; by default the one that it was trained on.
        shares: percentages of the demonstrations that go each way, in place of those of the dataset.
        episodes: how many.
        samples: chunks to sample at each start.
        seed: of the first episode, and of all else that is random.
        batch_size: episodes that act together.
        workers: processes that run episodes.
        cluster: whose; by default this machine's.
        thresholds: when to worry.

    Raises:
        ConfigurationError: numbers that make no sense.
    """

    checkpoint: str
    environment: EnvironmentSpec
    dataset: str | None = None
    shares: tuple[float, ...] = ()
    episodes: int = 200
    samples: int = 16
    seed: int = FIRST_SEED
    batch_size: int = 50
    workers: int = 1
    cluster: Cluster | None = None
    thresholds: Thresholds = field(default_factory=Thresholds)

    def __post_init__(self) -> None:
        check_at_least(
            1,
            episodes=self.episodes,
            samples=self.samples,
            batch_size=self.batch_size,
            workers=self.workers,
        )
        check_at_least(0, seed=self.seed)
        whole = math.isclose(sum(self.shares), 100, abs_tol=0.5)
        if self.shares and (len(self.shares) < 2 or min(self.shares) < 0 or not whole):
            shown = ",".join(f"{each:g}" for each in self.shares)
            raise ConfigurationError(
                f"--shares={shown}: give a percentage for each of two ways or more, 100 together, as 80,15,5"
            )


def parse_shares(text: str | None) -> tuple[float, ...]:
    """Percentages with commas between them; none if nothing is given.

    Raises:
        ConfigurationError: no numbers.
    """
    try:
        return tuple(float(each) for each in text.split(",")) if text else ()
    except ValueError:
        raise ConfigurationError(f"--shares={text} must be percentages, as in 80,15,5") from None
