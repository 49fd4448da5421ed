"""From an action likelihood's name to its head."""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

from lerobot_act_chunking.errors import ConfigurationError, unknown_choice
from lerobot_act_chunking.heads.action_head import ActionHead
from lerobot_act_chunking.heads.categorical import CategoricalHead
from lerobot_act_chunking.heads.categorical_bins import tail_bins
from lerobot_act_chunking.heads.gaussian import GaussianHead
from lerobot_act_chunking.heads.laplace import LaplaceHead
from lerobot_act_chunking.heads.mixture import MixtureHead
from lerobot_act_chunking.heads.regression import RegressionHead


@dataclass(frozen=True)
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

    action_likelihood: str = "l1"
    nll_beta: float = 0.5
    min_std: float = 0.01
    n_components: int = 5
    n_bins: int = 256
    hl_gauss_sigma: float = 0.75
    soft_local_bins: int = 2
    action_temperature: float = 0.0
    action_top_k: int = 0

    @classmethod
    def from_fields(cls, source: Any) -> "HeadSpec":
        """The spec whose values are the attributes of ``source``, a policy's configuration."""
        return cls(**{field.name: getattr(source, field.name) for field in fields(cls)})

    def check(self) -> None:
        """Refuse values that cannot work.

        Raises:
            ConfigurationError: naming the value and the way out.
        """
        if self.action_likelihood not in HEADS:
            raise unknown_choice("action_likelihood", self.action_likelihood, HEADS)
        self._check_range("nll_beta", 0.0, 1.0)
        self._check_range("action_temperature", 0.0)
        if not 0 < self.min_std < 1:
            raise ConfigurationError(
                f"min_std={self.min_std} must be above 0 and below 1: normalised actions have a standard "
                "deviation of about 1"
            )
        self._check_range("n_components", 1.0)
        self._check_range("hl_gauss_sigma", 0.0)
        self._check_range("n_bins", 2.0 * (1 + tail_bins(self.hl_gauss_sigma)))
        self._check_range("soft_local_bins", 0.0)
        self._check_range("action_top_k", 0.0, float(self.n_bins))
        self._check_sampling()

    def _check_range(self, name: str, least: float, most: float = math.inf) -> None:
        value = getattr(self, name)
        if not (least <= value <= most and math.isfinite(value)):
            limits = f"at least {least:g}" + (f" and at most {most:g}" if most < math.inf else ", and finite")
            raise ConfigurationError(f"{name}={value} must be {limits}")

    def _check_sampling(self) -> None:
        likelihood = self.action_likelihood
        if self.action_temperature and likelihood in ("l1", "l2"):
            raise ConfigurationError(
                f"action_temperature={self.action_temperature}, but {likelihood} predicts one action and has "
                "nothing to sample: set action_temperature=0, or action_likelihood=gaussian"
            )
        if self.action_top_k and not self.action_temperature and likelihood == "categorical":
            raise ConfigurationError(
                f"action_top_k={self.action_top_k} limits what is sampled, but with action_temperature=0 "
                "nothing is: set action_temperature=1, or action_top_k=0"
            )


@dataclass(frozen=True)
class HeadSize:
    """Sizes that every head shares: D, A, Q, and the actions of a query."""

    dim: int
    action_dim: int
    n_queries: int
    actions_per_query: int

    @property
    def layer(self) -> tuple[int, int, int]:
        """What the output layer depends on."""
        return self.dim, self.action_dim, self.actions_per_query


HEADS: dict[str, Callable[[HeadSpec, HeadSize], ActionHead]] = {
    "l1": lambda spec, size: RegressionHead(*size.layer, power=1),
    "l2": lambda spec, size: RegressionHead(*size.layer, power=2),
    "laplace": lambda spec, size: LaplaceHead(
        *size.layer,
        n_queries=size.n_queries,
        beta=spec.nll_beta,
        min_std=spec.min_std,
        temperature=spec.action_temperature,
    ),
    "gaussian": lambda spec, size: GaussianHead(
        *size.layer,
        n_queries=size.n_queries,
        beta=spec.nll_beta,
        min_std=spec.min_std,
        temperature=spec.action_temperature,
    ),
    "gmm": lambda spec, size: MixtureHead(
        *size.layer,
        n_components=spec.n_components,
        beta=spec.nll_beta,
        min_std=spec.min_std,
        temperature=spec.action_temperature,
    ),
    "categorical": lambda spec, size: CategoricalHead(
        *size.layer,
        n_queries=size.n_queries,
        n_bins=spec.n_bins,
        sigma=spec.hl_gauss_sigma,
        soft_local_bins=spec.soft_local_bins,
        temperature=spec.action_temperature,
        top_k=spec.action_top_k,
    ),
}


def make_action_head(
    spec: HeadSpec, dim: int, action_dim: int, n_queries: int, actions_per_query: int
) -> ActionHead:
    """A fresh head for chunks of ``n_queries * actions_per_query`` actions.

    Raises:
        ConfigurationError: naming a value that cannot work.
    """
    spec.check()
    return HEADS[spec.action_likelihood](spec, HeadSize(dim, action_dim, n_queries, actions_per_query))
