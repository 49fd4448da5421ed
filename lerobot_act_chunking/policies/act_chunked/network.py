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

    The style token is a learned vector; when training a VAE, the embedded latent is added to it.
    """

    def __init__(
        self,
        *,
        observation_encoder: ObservationEncoder,
        style_encoder: StyleEncoder | None,
        encoder: Encoder,
        decoder: Decoder,
        head: RegressionHead,
    ):
        super().__init__()
        dim = decoder.start.numel()
        self.observation_encoder = observation_encoder
        self.style_encoder = style_encoder
        self.style_token = nn.Parameter(torch.randn(dim))
        self.style_position = nn.Parameter(torch.randn(1, dim))
        self.encoder = encoder
        self.decoder = decoder
        self.head = head

    def forward(
        self,
        observation: Observation,
        style: Float[Tensor, "B D"] | None = None,
        n_queries: int | None = None,
    ) -> Float[Tensor, "B T A"]:
        """Normalised actions of a chunk, or of its first ``n_queries`` queries.

        Args:
            observation: of the current step.
            style: embedded latent; None stands for the zero latent, ACT's choice when acting.
            n_queries: number of action queries to decode (default: all).
        """
        tokens, positions = self.observation_encoder(observation.vectors, observation.images)
        style_token = self.style_token.expand(len(tokens), -1)
        if style is not None:
            style_token = style_token + style
        tokens = torch.cat((style_token[:, None], tokens), dim=1)
        positions = torch.cat((self.style_position, positions))
        memory = self.encoder(tokens, positions)
        return self.head(self.decoder(memory, positions, n_queries))
