"""Everything that an action head is built from."""

from dataclasses import dataclass, fields
from typing import Any

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.heads.categorical_bins import tail_bins
from lerobot_act_chunking.ranges import RANGES, check_ranges


@dataclass(frozen=True, kw_only=True)
class HeadSpec:
    """How actions follow from features. Only the settings of the named likelihood count.

    Attributes:
        action_likelihood: ``l1`` (ACT), ``l2``, ``laplace``, ``gaussian`` (beta-NLL), ``gmm`` (a mixture
            whose component is chosen once per chunk) or ``categorical`` (bins over [-1, 1]).
        nll_beta: weighting of the loss of ``laplace``, ``gaussian`` and ``gmm`` (Seitzer et al. 2022). 0 is
            the plain likelihood, in which precise dimensions outweigh the others; larger values reduce this.
            With 1, means learn as from the squared error; with 0.5, locations of ``laplace`` learn as from
            the absolute error.
        min_std: least standard deviation of ``laplace``, ``gaussian`` and ``gmm``, in normalised units.
        n_components: number of components of ``gmm``.
        n_bins: number of bins of ``categorical``, more than its soft targets need for their tails.
        hl_gauss_sigma: standard deviation of the soft targets of ``categorical``, in bins; 0 for none.
        soft_local_bins: an action of ``categorical`` is the expected value over so many bins to either side
            of the chosen one; 0 takes the centre of the chosen one.
        action_temperature: 0 takes the likeliest action (or component); above 0 they are sampled, with 1 as
            learned.
        action_top_k: ``categorical`` samples among this many likeliest bins; 0 for all.
    """

    action_likelihood: str
    nll_beta: float
    min_std: float
    n_components: int
    n_bins: int
    hl_gauss_sigma: float
    soft_local_bins: int
    action_temperature: float
    action_top_k: int

    @classmethod
    def from_fields(cls, source: Any) -> "HeadSpec":
        """The spec whose values are the attributes of ``source``, a policy's configuration."""
        return cls(**{field.name: getattr(source, field.name) for field in fields(cls)})

    def check_numbers(self) -> None:
        """Refuse numbers that cannot work, whatever the likelihood.

        Raises:
            ConfigurationError: naming the value and the way out.
        """
        check_ranges(self, *(field.name for field in fields(self) if field.name in RANGES))
        least = 2 * (1 + tail_bins(self.hl_gauss_sigma))
        if self.n_bins < least:
            raise ConfigurationError(
                f"n_bins={self.n_bins} must be at least {least} with hl_gauss_sigma={self.hl_gauss_sigma}, "
                "whose soft targets need tails"
            )
        if self.action_top_k > self.n_bins:
            raise ConfigurationError(
                f"action_top_k={self.action_top_k} must be at most n_bins={self.n_bins}: 0 takes all"
            )


@dataclass(frozen=True)
class HeadSize:
    """Sizes that every head shares.

    Attributes:
        dim: width D of features.
        action_dim: A.
        n_queries: Q.
        actions_per_query: consecutive actions of each query.
    """

    dim: int
    action_dim: int
    n_queries: int
    actions_per_query: int

    @property
    def layer(self) -> tuple[int, int, int]:
        """What the output layer depends on."""
        return self.dim, self.action_dim, self.actions_per_query
