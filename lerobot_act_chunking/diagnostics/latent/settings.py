"""What is asked: of which policy, on which demonstrations, and when to worry."""

from dataclasses import dataclass, field

from act_chunking_runtime.number_checks import check_at_least


@dataclass(frozen=True)
class Thresholds:
    """When to worry.

    Attributes:
        information: decoding with another demonstration's style must raise the error by this share; else the
            decoder does not listen to the latent.
        outside: share of the prior's samples that nothing demonstrated is like.
        starved: share of the demonstrations that the prior hardly samples.
        by_place: share of the styles' variance that the place in the episode explains, beyond which sampling
            without looking at the observation gives styles of other situations.
        poor_group: error of a group, relative to the mean, beyond which the decoder has not learned it.
    """

    information: float = 0.05
    outside: float = 0.1
    starved: float = 0.02
    by_place: float = 0.3
    poor_group: float = 2.0


@dataclass(frozen=True)
class Settings:
    """What to diagnose.

    Attributes:
        checkpoint: an `act_chunked` checkpoint with a latent: folder or repo id.
        dataset: a LeRobotDataset's folder, best the one it was trained on.
        samples: chunks to encode, evenly spread over the dataset.
        seed: of all that is random.
        thresholds: when to worry.

    Raises:
        ConfigurationError: fewer than two samples.
    """

    checkpoint: str
    dataset: str
    samples: int = 4000
    seed: int = 0
    thresholds: Thresholds = field(default_factory=Thresholds)

    def __post_init__(self) -> None:
        check_at_least(2, samples=self.samples)
