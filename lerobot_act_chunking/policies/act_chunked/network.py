"""The network of `act_chunked`: observation tokens, transformer, action head."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from lerobot_act_chunking.data.batch import Observation
from lerobot_act_chunking.heads.regression import RegressionHead
from lerobot_act_chunking.nn.observation import ObservationEncoder
from lerobot_act_chunking.nn.style import StyleEncoder
from lerobot_act_chunking.nn.transformer import Decoder, Encoder


class ActNetwork(nn.Module):
    """An encoder over one style token and all observation tokens, a decoder from action queries to actions.

    Without a style encoder, the style token is a plain learned vector.
    """

    def __init__(
        self,
        *,
        observation_encoder: ObservationEncoder,
        style_encoder: StyleEncoder | None,
        latent_dim: int,
        encoder: Encoder,
        decoder: Decoder,
        head: RegressionHead,
    ):
        super().__init__()
        dim = decoder.start.numel()
        self.observation_encoder = observation_encoder
        self.style_encoder = style_encoder
        self.style_proj = nn.Linear(latent_dim, dim) if style_encoder is not None else None
        self.style_token = nn.Parameter(torch.zeros(dim)) if style_encoder is None else None
        self.style_position = nn.Parameter(torch.randn(1, dim))
        self.encoder = encoder
        self.decoder = decoder
        self.head = head

    def forward(
        self,
        observation: Observation,
        latent: Float[Tensor, "B L"] | None = None,
        n_queries: int | None = None,
    ) -> Float[Tensor, "B T A"]:
        """Normalised actions of a chunk, or of its first ``n_queries`` queries.

        Args:
            observation: of the current step.
            latent: the style to act in, if the network has a style encoder; None stands for zeros, ACT's
            choice
                when acting.
            n_queries: number of action queries to decode (default: all).
        """
        tokens, positions = self.observation_encoder(observation.vectors, observation.images)
        tokens = torch.cat((self._style(latent, len(tokens))[:, None], tokens), dim=1)
        positions = torch.cat((self.style_position, positions))
        memory = self.encoder(tokens, positions)
        return self.head(self.decoder(memory, positions, n_queries))

    def _style(self, latent: Float[Tensor, "B L"] | None, batch_size: int) -> Float[Tensor, "B D"]:
        if self.style_proj is None:
            return self.style_token.expand(batch_size, -1)
        if latent is None:
            latent = self.style_proj.weight.new_zeros(batch_size, self.style_proj.in_features)
        return self.style_proj(latent)
