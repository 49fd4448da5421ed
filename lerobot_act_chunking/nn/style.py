"""The style encoder of ACT's conditional VAE: which of several ways to act this demonstration took."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from lerobot_act_chunking.nn.positions import sequence_positions
from lerobot_act_chunking.nn.transformer import Encoder, LayerSpec


class StyleEncoder(nn.Module):
    """q(z | actions, state) from a class token, the joint state (if there is one) and the action chunk.

    Source: ACT (Zhao et al. 2023), section IV-C. Only the class token is read, so the last layer computes
    only it.
    """

    def __init__(
        self,
        spec: LayerSpec,
        *,
        n_layers: int,
        chunk_size: int,
        action_dim: int,
        state_dim: int | None,
        latent_dim: int,
    ):
        super().__init__()
        self.cls = nn.Parameter(torch.randn(spec.dim))
        self.state_proj = None if state_dim is None else nn.Linear(state_dim, spec.dim)
        self.action_proj = nn.Linear(action_dim, spec.dim)
        self.encoder = Encoder(spec, n_layers)
        self.posterior_proj = nn.Linear(spec.dim, 2 * latent_dim)
        self.latent_proj = nn.Linear(latent_dim, spec.dim, bias=False)
        n_leading = 1 if state_dim is None else 2
        self.positions: Tensor
        self.register_buffer(
            "positions", sequence_positions(n_leading + chunk_size, spec.dim), persistent=False
        )

    def forward(
        self,
        actions: Float[Tensor, "B T A"],
        is_pad: Bool[Tensor, "B T"],
        state: Float[Tensor, "B S"] | None,
    ) -> tuple[Float[Tensor, "B L"], Float[Tensor, "B L"]]:
        """Mean and log-variance of the latent; padded actions are not seen."""
        leading = [self.cls.expand(len(actions), 1, -1)]
        if self.state_proj is not None:
            leading.append(self.state_proj(state)[:, None])
        tokens = torch.cat((*leading, self.action_proj(actions)), dim=1)
        is_pad = torch.cat((is_pad.new_zeros(len(actions), len(leading)), is_pad), dim=1)
        cls = self.encoder(tokens, self.positions, is_pad, n_out=1)[:, 0]
        mean, log_variance = self.posterior_proj(cls).chunk(2, dim=-1)
        return mean, log_variance

    def embed(self, latent: Float[Tensor, "B L"]) -> Float[Tensor, "B D"]:
        """What a latent adds to the policy's style token; nothing for the zero latent that ACT acts with."""
        return self.latent_proj(latent)


def sample_latent(
    mean: Float[Tensor, "B L"], log_variance: Float[Tensor, "B L"], noise: Float[Tensor, "B L"]
) -> Float[Tensor, "B L"]:
    """Reparametrised sample (Kingma & Welling 2014, section 2.4) from standard normal ``noise``."""
    return mean + (log_variance / 2).exp() * noise


def kl_to_standard_normal(
    mean: Float[Tensor, "B L"], log_variance: Float[Tensor, "B L"]
) -> Float[Tensor, " B"]:
    """KL(q || N(0, I)) of each sample [nats], summed over the latent (Kingma & Welling 2014, appendix B)."""
    return -0.5 * (1 + log_variance - mean.square() - log_variance.exp()).sum(-1)
