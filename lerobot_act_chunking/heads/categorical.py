"""Actions in bins: any distribution of every element, with several modes if need be."""

from typing import ClassVar

from jaxtyping import Float, Int64
from torch import Tensor

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.heads.action_head import ElementHead
from lerobot_act_chunking.heads.categorical_bins import bin_limit, cross_entropy, soft_local, soft_targets
from lerobot_act_chunking.heads.codes import inverse_cdf_index
from lerobot_act_chunking.heads.spec import HeadSize, HeadSpec


class CategoricalHead(ElementHead):
    """Logits of equal bins over [-1, 1] for every element, scored by cross-entropy against soft targets.

    Soft targets (HL-Gauss, Imani and White 2018) tell neighbouring bins from far ones. Elements are
    independent given the features: what must go together, such as the steps of one of several ways, a latent
    or an autoregressive decoder has to decide.

    Args:
        dim: width D of features.
        action_dim: A.
        actions_per_query: consecutive actions of each query.
        n_queries: Q.
        n_bins: M.
        sigma: standard deviation of the soft targets, in bins; 0 for none.
        soft_local_bins: an action is the expected one within this many bins of the chosen; 0: its centre.
        temperature: divides the logits when sampling; 0 takes the likeliest bin.
        top_k: samples are among this many likeliest bins; 0 for all.
    """

    is_bounded: ClassVar[bool] = True

    def __init__(
        self,
        dim: int,
        action_dim: int,
        actions_per_query: int,
        *,
        n_queries: int,
        n_bins: int,
        sigma: float,
        soft_local_bins: int,
        temperature: float,
        top_k: int,
    ):
        super().__init__(dim, action_dim, actions_per_query, n_parameters=n_bins)
        self.n_bins, self.sigma = n_bins, sigma
        self.limit = bin_limit(n_bins, sigma)
        self.soft_local_bins, self.temperature, self.top_k = soft_local_bins, temperature, top_k
        if temperature > 0:
            self.draws_shape = (n_queries * actions_per_query, action_dim)

    @classmethod
    def from_spec(cls, spec: HeadSpec, size: HeadSize) -> "CategoricalHead":
        """A fresh head with these settings."""
        return cls(
            *size.layer,
            n_queries=size.n_queries,
            n_bins=spec.n_bins,
            sigma=spec.hl_gauss_sigma,
            soft_local_bins=spec.soft_local_bins,
            temperature=spec.action_temperature,
            top_k=spec.action_top_k,
        )

    @classmethod
    def check(cls, spec: HeadSpec) -> None:
        """Refuse to limit what is sampled where nothing is.

        Raises:
            ConfigurationError: naming the value and the way out.
        """
        if spec.action_top_k and not spec.action_temperature:
            raise ConfigurationError(
                f"action_top_k={spec.action_top_k} limits what is sampled, but with action_temperature=0 "
                "nothing is: set action_temperature=1, or action_top_k=0"
            )

    def element_loss(
        self, features: Float[Tensor, "B Q D"], actions: Float[Tensor, "B T A"]
    ) -> Float[Tensor, "B T A"]:
        """Cross-entropy of each element [nats]."""
        logits = self.parameters_of(features)
        return cross_entropy(logits, *soft_targets(actions.to(logits), self.n_bins, self.sigma))

    def choose(
        self, features: Float[Tensor, "B q D"], draws: Float[Tensor, "B t A"] | None
    ) -> Float[Tensor, "B t A"]:
        """The actions of the likeliest bins, or of sampled ones."""
        logits = self.parameters_of(features)
        bins = logits.argmax(-1) if draws is None else self._sample(logits, draws)
        return soft_local(logits, bins, self.soft_local_bins, self.limit)

    def _sample(
        self, logits: Float[Tensor, "B t A M"], draws: Float[Tensor, "B t A"]
    ) -> Int64[Tensor, "B t A"]:
        if not self.top_k:
            return inverse_cdf_index(logits, draws, temperature=self.temperature, top_p=1.0)
        likeliest, bins = logits.topk(self.top_k)
        rank = inverse_cdf_index(likeliest, draws, temperature=self.temperature, top_p=1.0)
        return bins.take_along_dim(rank[..., None], dim=-1)[..., 0]
