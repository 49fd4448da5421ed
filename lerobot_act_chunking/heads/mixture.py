"""A few ways to go on, one of which is taken for the whole chunk."""

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor, nn

from lerobot_act_chunking.heads.action_head import Act, ActionHead, at_least_single
from lerobot_act_chunking.heads.action_scale import BoundedScale
from lerobot_act_chunking.heads.codes import inverse_cdf_index
from lerobot_act_chunking.heads.gaussian import mean_with_scaled_gradient, normal_nll
from lerobot_act_chunking.heads.spec import HeadSize, HeadSpec
from lerobot_act_chunking.nn.masking import PadNormalization, per_element
from lerobot_act_chunking.nn.processes import mean_over_processes

USAGE_DECAY = 0.99  # of the moving average over batches
IDLE_SHARE = 0.1  # of what every component would have if all were used alike
IDLE_WEIGHT = 0.1  # of the loss that moves idle components


class MixtureHead(ActionHead):
    """A mixture of M Gaussians over whole chunks: p(a) = sum_m w_m prod_k,j N(a_kj; mu_mkj, sigma_mkj).

    One choice for all steps: a component for each step would mix the ways again. The weights w follow from
    the features of the chunk's first query, so that few decoded queries choose as all would. Acting takes
    the mean of the chosen component, without its noise (robomimic's evaluation, Mandlekar et al. 2021).

    Over hundreds of elements, a component that is a little better is better by hundreds of nats. It gets the
    whole gradient from the first batches on, and the others never learn. In training mode, components whose
    moving share of the chunks is negligible are therefore moved, with a small weight, to the chunks that the
    mixture explains worst (`_idle_loss`). A component that has a share follows the likelihood alone: nothing
    depends on the length of the training, and the optimum is that of maximum likelihood.

    Args:
        dim: width D of features.
        action_dim: A.
        actions_per_query: consecutive actions of each query.
        n_components: M.
        beta: in [0, 1]: the gradient of means is multiplied by ``sigma^(2 beta)``, as in beta-NLL; otherwise
            what is already precise would drown all else. Loss and responsibilities stay as they are.
        min_std: least sigma, in normalised action units.
        temperature: components have their weights to the power of its inverse; 0 takes the likeliest.
    """

    def __init__(
        self,
        dim: int,
        action_dim: int,
        actions_per_query: int,
        *,
        n_components: int,
        beta: float,
        min_std: float,
        temperature: float,
    ):
        super().__init__()
        self.actions_per_query = actions_per_query
        self.parameter_shape = (actions_per_query, n_components, action_dim, 2)
        self.projection = nn.Linear(dim, actions_per_query * n_components * action_dim * 2)
        self.choice = nn.Linear(dim, n_components)
        self.scale = BoundedScale(min_std)
        self.beta = beta
        self.temperature = temperature
        if temperature > 0:
            self.draws_shape = (1,)
        self.usage: Tensor
        self.register_buffer("usage", torch.zeros(n_components))  # at first, all are called

    @classmethod
    def from_spec(cls, spec: HeadSpec, size: HeadSize) -> "MixtureHead":
        """A fresh head with these settings."""
        return cls(
            *size.layer,
            n_components=spec.n_components,
            beta=spec.nll_beta,
            min_std=spec.min_std,
            temperature=spec.action_temperature,
        )

    def log_weights(self, features: Float[Tensor, "B q D"]) -> Float[Tensor, "B M"]:
        """Logarithms of the components' weights; ``features`` begin with those of the first query."""
        return at_least_single(self.choice(features[:, 0])).log_softmax(-1)

    def components(
        self, features: Float[Tensor, "B q D"]
    ) -> tuple[Float[Tensor, "B t M A"], Float[Tensor, "B t M A"]]:
        """Means and log standard deviations."""
        flat = at_least_single(self.projection(features))
        mean, raw = flat.unflatten(-1, self.parameter_shape).flatten(1, 2).unbind(-1)
        return mean, self.scale.log(raw)

    def _loss(
        self,
        features: Float[Tensor, "B Q D"],
        actions: Float[Tensor, "B T A"],
        is_pad: Bool[Tensor, "B T"],
        normalization: PadNormalization,
    ) -> Float[Tensor, " B"]:
        mean, log_std = self.components(features)
        mean = mean_with_scaled_gradient(mean, log_std, self.beta)
        nll = normal_nll(actions[:, :, None], mean, log_std) * ~is_pad[..., None, None]  # (B, T, M, A)
        joint = self.log_weights(features) - nll.sum((1, 3))
        total = -joint.logsumexp(-1)
        if self.training:
            self._count(joint)
            total = total + self._idle_loss(nll, log_std, total)
        return per_element(total, is_pad, actions.shape[-1], normalization)

    @torch.no_grad()
    def _count(self, joint: Float[Tensor, "B M"]) -> None:
        """Update the components' shares by their responsibilities for this batch."""
        shares = mean_over_processes(joint.softmax(-1).mean(0))
        self.usage.lerp_(shares.to(self.usage), 1 - USAGE_DECAY)

    def _idle_loss(
        self, nll: Float[Tensor, "B T M A"], log_std: Float[Tensor, "B T M A"], total: Float[Tensor, " B"]
    ) -> Float[Tensor, " B"]:
        """Loss that moves idle components to the worst-explained chunks, in proportion to their excess loss.

        Its weights make the means learn as from the squared error. From the likelihood, a component that is
        far off would become wide and not move.
        """
        excess = (total - mean_over_processes(total.mean())).detach().clamp_min(0)
        usual = mean_over_processes(excess.mean())
        shares = excess / usual.clamp_min(torch.finfo(excess.dtype).tiny)
        idle = self.usage < IDLE_SHARE / len(self.usage)
        weights = (2 * (1 - self.beta) * log_std.detach()).exp() * idle[:, None]
        return IDLE_WEIGHT * shares * (nll * weights).sum((1, 2, 3))

    def _actor(self, draws: Float[Tensor, "B 1"] | None) -> Act:
        chosen: Int64[Tensor, " B"] | None = None

        def act(features: Float[Tensor, "B q D"]) -> Float[Tensor, "B t A"]:
            nonlocal chosen
            if chosen is None:
                chosen = self._choose(features, draws)
            mean, _ = self.components(features)
            return mean.take_along_dim(chosen[:, None, None, None], dim=2)[:, :, 0]

        return act

    def _choose(
        self, features: Float[Tensor, "B q D"], draws: Float[Tensor, "B 1"] | None
    ) -> Int64[Tensor, " B"]:
        log_weights = self.log_weights(features)
        if draws is None:
            return log_weights.argmax(-1)
        return inverse_cdf_index(log_weights, draws[:, 0], temperature=self.temperature, top_p=1.0)
