"""The network of `act_chunked`: observation tokens, transformer, action head."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from lerobot_act_chunking.data.batch import ActionTarget, Observation
from lerobot_act_chunking.heads.action_head import ActionHead
from lerobot_act_chunking.nn.autoregressive import AutoregressiveDecoder
from lerobot_act_chunking.nn.latents.latent import Latent, Posterior
from lerobot_act_chunking.nn.masking import PadNormalization
from lerobot_act_chunking.nn.observation import ObservationEncoder
from lerobot_act_chunking.nn.style_encoder import StyleEncoder
from lerobot_act_chunking.nn.transformer import Decoder, Encoder


class Seen(NamedTuple):
    """Observations as tokens (B, N, D), and the tokens' positions (N, D)."""

    tokens: Tensor
    positions: Tensor

    def repeat(self, n_samples: int) -> "Seen":
        """The same observations ``n_samples`` times, one copy behind the other."""
        return self if n_samples == 1 else Seen(self.tokens.repeat(n_samples, 1, 1), self.positions)


@dataclass(frozen=True)
class Lesson:
    """Observations, and the demonstrated actions that go with them.

    Attributes:
        seen: observations.
        state: the current joint state (B, S), if there is one.
        target: the actions.
        taught: what an autoregressive decoder is shown of them (B, T, A) ...
        shown: ... and which queries' actions it is shown (B, Q); None for all.
    """

    seen: Seen
    state: Float[Tensor, "B S"] | None
    target: ActionTarget
    taught: Float[Tensor, "B T A"]
    shown: Bool[Tensor, "B Q"] | None


class ActNetwork(nn.Module):
    """An encoder over one style token and all observation tokens, a decoder from action queries to actions.

    The style token is a learned vector; with a latent, its embedding is added to it.
    """

    def __init__(
        self,
        *,
        observation_encoder: ObservationEncoder,
        style_encoder: StyleEncoder | None,
        latent: Latent | None,
        encoder: Encoder,
        decoder: Decoder | AutoregressiveDecoder,
        head: ActionHead,
        dim: int,
    ):
        super().__init__()
        self.observation_encoder = observation_encoder
        self.style_encoder = style_encoder
        self.latent = latent
        self.style_token = nn.Parameter(torch.randn(dim))
        self.style_position = nn.Parameter(torch.randn(1, dim))
        self.encoder = encoder
        self.decoder = decoder
        self.head = head

    def see(self, window: Observation) -> Seen:
        """Tokens of observations (B, H, ...)."""
        return Seen(*self.observation_encoder(window.vectors, window.images))

    def posterior(self, lesson: Lesson, noise: Float[Tensor, "B n"]) -> Posterior:
        """The style that the demonstrated actions show. Only with a latent."""
        assert self.style_encoder is not None  # noqa: S101
        assert self.latent is not None  # noqa: S101
        target, tokens = lesson.target, lesson.seen.tokens
        parameters = self.style_encoder(target.actions, target.is_pad, lesson.state, tokens)
        return self.latent.posterior(parameters, noise, tokens)

    def prior(self, seen: Seen, noise: Float[Tensor, "B n"] | None) -> Float[Tensor, "B L"] | None:
        """The style to act in: what ``noise`` samples, or the likeliest; None without a latent."""
        return None if self.latent is None else self.latent.prior(noise, seen.tokens)

    def loss(
        self, lesson: Lesson, latent: Float[Tensor, "B L"] | None, normalization: PadNormalization
    ) -> Float[Tensor, " B"]:
        """How far off or how unlikely the demonstrated actions are in this style."""
        memory, positions = self._remember(lesson.seen, latent)
        if isinstance(self.decoder, AutoregressiveDecoder):
            features = self.decoder(memory, positions, lesson.taught, lesson.shown)
        else:
            features = self.decoder(memory, positions)
        return self.head.loss(features, lesson.target.actions, lesson.target.is_pad, normalization)

    def act(
        self,
        seen: Seen,
        latent: Float[Tensor, "B L"] | None,
        draws: Float[Tensor, "B *S"] | None,
        n_queries: int,
    ) -> Float[Tensor, "B T A"]:
        """Normalised actions of the first ``n_queries`` queries.

        Args:
            seen: observations.
            latent: style to act in; None without one.
            draws: uniform numbers by which the head samples; None for what is likeliest.
            n_queries: number of action queries to decode.
        """
        memory, positions = self._remember(seen, latent)
        act = self.head.actor(draws)
        if isinstance(self.decoder, AutoregressiveDecoder):
            return self.decoder.generate(memory, positions, n_queries, act)
        return act(self.decoder(memory, positions, n_queries))

    def _remember(
        self, seen: Seen, latent: Float[Tensor, "B L"] | None
    ) -> tuple[Float[Tensor, "B N D"], Float[Tensor, "N D"]]:
        """All tokens after they have looked at each other, and their positions."""
        style = self.style_token.expand(len(seen.tokens), -1)
        if latent is not None and self.style_encoder is not None:
            style = style + self.style_encoder.embed(latent)
        tokens = torch.cat((style[:, None], seen.tokens), dim=1)
        positions = torch.cat((self.style_position, seen.positions))
        return self.encoder(tokens, positions), positions
