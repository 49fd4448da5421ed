"""Figures of a latent: is it in use, and does a prior sample what was demonstrated?"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int64

from lerobot_act_chunking.diagnostics.core.latents.encoding import Encoded
from lerobot_act_chunking.diagnostics.core.samples import Samples
from lerobot_act_chunking.nn.latents.health import ACTIVE_NATS, ACTIVE_VARIANCE

WITHIN = (
    99.0  # percentile of the demonstrations' own distances, beyond which a style counts as undemonstrated
)
STARVED = 0.25  # of a group's share among the demonstrations
PLACES = 20  # sections of an episode
SMALLEST_GROUP = 0.01  # share of the demonstrations, below which a group is too small to judge


@dataclass(frozen=True)
class Health:
    """How much posteriors say.

    Attributes:
        kl: mean divergence from the trained prior [nats].
        kl_by_dimension: of each dimension; one number where only the sum is known.
        mean_variance: (L,) variance of the posterior means over the demonstrations.
        by_place: share of that variance, over all dimensions, which the place in the episode explains: what
            the observation tells anyway, and what a prior that does not see it cannot know.
    """

    kl: float
    kl_by_dimension: list[float]
    mean_variance: list[float]
    by_place: float

    @property
    def active_units(self) -> int:
        """Dimensions whose mean depends on the demonstration (Burda et al. 2016, section 5.2)."""
        return sum(variance > ACTIVE_VARIANCE for variance in self.mean_variance)

    @property
    def kl_active_dims(self) -> int:
        """Dimensions with a divergence."""
        return sum(kl > ACTIVE_NATS for kl in self.kl_by_dimension)


@dataclass(frozen=True)
class PriorCheck:
    """Samples of a prior beside the encoded demonstrations.

    Attributes:
        name: of the prior.
        outside: share of its samples that are farther from every demonstrated style than 99 % of those are
            from each other: what the decoder was never taught to decode.
        starved: share of the demonstrations in groups that it samples less than a quarter as often.
        groups: its share in each group.
    """

    name: str
    outside: float
    starved: float
    groups: list[float]


@dataclass(frozen=True)
class Group:
    """Demonstrations whose styles are alike: a component of the fitted density, or a code.

    Attributes:
        share: of the demonstrations.
        error: mean absolute error when decoded from the posterior [normalised units]; None if none was.
    """

    share: float
    error: float | None


def measure_health(encoded: Encoded, progress: Float[np.ndarray, " N"]) -> Health:
    """Divergences and variances over demonstrations at these places (0 to 1) in their episodes."""
    by_dimension, variance = encoded.divergence.mean(0), encoded.mean.var(0)
    place = np.minimum((progress * PLACES).astype(int), PLACES - 1)
    left = sum(np.square(part - part.mean(0)).sum() for part in _split(encoded.mean, place))
    total = max(len(place) * variance.sum(), 1e-12)
    return Health(
        float(by_dimension.sum()), by_dimension.tolist(), variance.tolist(), float(max(1 - left / total, 0.0))
    )


def _split(values: Float[np.ndarray, "N L"], group: Int64[np.ndarray, " N"]) -> list[np.ndarray]:
    return [values[group == each] for each in np.unique(group)]


def check_prior(
    name: str,
    drawn: Float[np.ndarray, "n L"],
    encoded: Encoded,
    samples: Samples,
    groups: tuple[Int64[np.ndarray, " N"], Int64[np.ndarray, " n"], int],
) -> PriorCheck:
    """Hold a prior's samples against the demonstrated styles.

    Args:
        name: of the prior.
        drawn: its samples.
        encoded: the demonstrations.
        samples: where they come from.
        groups: the group of each demonstration, that of each of the prior's samples, and how many there are.
    """
    of_demonstrations, of_prior, n_groups = groups
    shares = np.bincount(of_demonstrations, minlength=n_groups) / len(of_demonstrations)
    own = np.bincount(of_prior, minlength=n_groups) / len(of_prior)
    starved = shares[(shares >= SMALLEST_GROUP) & (own < STARVED * shares)].sum()
    return PriorCheck(name, share_outside(drawn, encoded, samples.episode), float(starved), own.tolist())


def share_outside(
    drawn: Float[np.ndarray, "n L"], encoded: Encoded, episode: Int64[np.ndarray, " N"]
) -> float:
    """Share of styles farther from the demonstrated ones than those of other episodes are.

    Distances are to the nearest style of every other episode, in the active dimensions alone, each in units
    of its standard deviation. Without an active dimension nothing is outside.
    """
    from scipy.spatial import KDTree

    active = encoded.mean.var(0) > ACTIVE_VARIANCE
    if not active.any():
        return 0.0
    unit = np.maximum(encoded.z[:, active].std(0), 1e-9)  # a code that no demonstration has does not vary
    demonstrated, drawn = encoded.z[:, active] / unit, drawn[:, active] / unit
    held = _other_half(episode)
    reference = KDTree(demonstrated[~held])
    usual, _ = reference.query(demonstrated[held])
    distance, _ = reference.query(drawn)
    return float((distance > np.percentile(usual, WITHIN)).mean())


def _other_half(episode: Int64[np.ndarray, " N"]) -> np.ndarray:
    """Every other episode; of a single one, every other sample."""
    order = np.unique(episode, return_inverse=True)[1]
    return order % 2 == 1 if order.any() else np.arange(len(episode)) % 2 == 1


def measure_groups(
    of_demonstrations: Int64[np.ndarray, " N"],
    n_groups: int,
    decoded: Int64[np.ndarray, " n"],
    errors: Float[np.ndarray, " n"],
) -> list[Group]:
    """Shares of the groups among the demonstrations, and how well the decoder knows each.

    Args:
        of_demonstrations: group of each demonstration.
        n_groups: how many there are.
        decoded: group of each of those that were decoded.
        errors: of these.
    """
    shares = np.bincount(of_demonstrations, minlength=n_groups) / len(of_demonstrations)
    found = [errors[decoded == group] for group in range(n_groups)]
    return [
        Group(float(share), float(mine.mean()) if mine.size else None)
        for share, mine in zip(shares, found, strict=True)
    ]
