"""The network of `act_chunked`: observation tokens, transformer, action head."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from lerobot_act_chunking.data.batch import ActionTarget, Observation
from lerobot_act_chunking.heads.action_head import ActionHead
from lerobot_act_chunking.nn.autoregressive import AutoregressiveDecoder
from lerobot_act_chunking.nn.instruction import InstructionEmbedding
from lerobot_act_chunking.nn.language.encoder import TextEncoder
from lerobot_act_chunking.nn.language.text import Text
from lerobot_act_chunking.nn.latents.latent import Latent, Posterior
from lerobot_act_chunking.nn.masking import PadNormalization
from lerobot_act_chunking.nn.observation import ObservationEncoder
from lerobot_act_chunking.nn.prefix import GivenActions, PrefixEncoder
from lerobot_act_chunking.nn.style_encoder import StyleEncoder
from lerobot_act_chunking.nn.transformer import Decoder, Encoder
from lerobot_act_chunking.policies.language.fields import INSTRUCTION


class EncodedObservation(NamedTuple):
    """What a chunk is predicted from.

    Attributes:
        tokens: observations (B, N, D).
        positions: of the tokens (N, D).
        prefix: what the chunk has to continue and what the policy is told (B, D); None if neither.
        text: the instruction, for an encoder that reads it word by word; None for others.
    """

    tokens: Tensor
    positions: Tensor
    prefix: Tensor | None = None
    text: Text | None = None

    def repeat(self, n_samples: int) -> "EncodedObservation":
        """The same ``n_samples`` times, one copy behind the other."""
        if n_samples == 1:
            return self
        prefix = None if self.prefix is None else self.prefix.repeat(n_samples, 1)
        text = self.text and self.text.repeat(n_samples)
        return EncodedObservation(self.tokens.repeat(n_samples, 1, 1), self.positions, prefix, text)


@dataclass(frozen=True)
class TrainingBatch:
    """Observations, and the demonstrated actions that go with them.

    Attributes:
        observation: encoded observations.
        state: the current joint state (B, S), if there is one.
        target: the actions.
        ignored: actions that the loss leaves out (B, T): padding, and what is given.
        decoder_inputs: actions that an autoregressive decoder gets as inputs (B, T, A).
        decoder_input_mask: queries whose actions it gets (B, Q); None for all.
    """

    observation: EncodedObservation
    state: Float[Tensor, "B S"] | None
    target: ActionTarget
    ignored: Bool[Tensor, "B T"]
    decoder_inputs: Float[Tensor, "B T A"]
    decoder_input_mask: Bool[Tensor, "B Q"] | None


class ActNetwork(nn.Module):
    """An encoder over one style token and all observation tokens, a decoder from action queries to actions.

    The style token is a learned vector; a latent's embedding, that of given first actions and that of an
    instruction are added to it. A token of its own for the instruction would cost a fifth more for a chunk.
    An encoder that reads an instruction itself hands on the observation's tokens, which have read it.
    """

    def __init__(
        self,
        *,
        observation_encoder: ObservationEncoder,
        style_encoder: StyleEncoder | None,
        latent: Latent | None,
        encoder: Encoder | TextEncoder,
        decoder: Decoder | AutoregressiveDecoder,
        head: ActionHead,
        prefix_encoder: PrefixEncoder | None,
        dim: int,
        instruction: InstructionEmbedding | None = None,
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
        self.prefix_encoder = prefix_encoder
        self.instruction = instruction
        self.told = None if instruction is None else nn.Linear(instruction.reader.dim, dim)

    def encode_observation(
        self, window: Observation, given: GivenActions | None = None
    ) -> EncodedObservation:
        """Tokens of observations (B, H, ...), and the first actions that the chunk has to continue."""
        prefix = None if given is None or self.prefix_encoder is None else self.prefix_encoder(given)
        if self.told is not None:
            told = self.told(window.vectors[INSTRUCTION][:, -1])
            prefix = told if prefix is None else prefix + told
        tokens, positions = self.observation_encoder(window.vectors, window.images)
        return EncodedObservation(tokens, positions, prefix, window.text)

    def posterior(self, batch: TrainingBatch, noise: Float[Tensor, "B n"]) -> Posterior:
        """The style that the demonstrated actions show. Only with a latent."""
        assert self.style_encoder is not None  # noqa: S101
        assert self.latent is not None  # noqa: S101
        target, tokens = batch.target, batch.observation.tokens
        parameters = self.style_encoder(target.actions, target.is_pad, batch.state, tokens)
        return self.latent.posterior(parameters, noise, tokens)

    def prior(
        self, observation: EncodedObservation, noise: Float[Tensor, "B n"] | None
    ) -> Float[Tensor, "B L"] | None:
        """The style to act in: what ``noise`` samples, or the likeliest; None without a latent."""
        return None if self.latent is None else self.latent.prior(noise, observation.tokens)

    def loss(
        self, batch: TrainingBatch, latent: Float[Tensor, "B L"] | None, normalization: PadNormalization
    ) -> Float[Tensor, " B"]:
        """How far off or how unlikely the demonstrated actions are in this style."""
        memory, positions = self._encode(batch.observation, latent)
        if isinstance(self.decoder, AutoregressiveDecoder):
            features = self.decoder(memory, positions, batch.decoder_inputs, batch.decoder_input_mask)
        else:
            features = self.decoder(memory, positions)
        return self.head.loss(features, batch.target.actions, batch.ignored, normalization)

    def act(
        self,
        observation: EncodedObservation,
        latent: Float[Tensor, "B L"] | None,
        draws: Float[Tensor, "B *S"] | None,
        n_queries: int,
    ) -> Float[Tensor, "B T A"]:
        """Normalised actions of the first ``n_queries`` queries.

        Args:
            observation: encoded observations.
            latent: style to act in; None without one.
            draws: uniform numbers by which the head samples; None for what is likeliest.
            n_queries: number of action queries to decode.
        """
        memory, positions = self._encode(observation, latent)
        act = self.head.actor(draws)
        if isinstance(self.decoder, AutoregressiveDecoder):
            return self.decoder.generate(memory, positions, n_queries, act)
        return act(self.decoder(memory, positions, n_queries))

    def _encode(
        self, observation: EncodedObservation, latent: Float[Tensor, "B L"] | None
    ) -> tuple[Float[Tensor, "B N D"], Float[Tensor, "N D"]]:
        """All tokens after they have looked at each other, and their positions."""
        style = self.style_token.expand(len(observation.tokens), -1)
        if latent is not None and self.style_encoder is not None:
            style = style + self.style_encoder.embed(latent)
        if observation.prefix is not None:
            style = style + observation.prefix
        tokens = torch.cat((style[:, None], observation.tokens), dim=1)
        positions = torch.cat((self.style_position, observation.positions))
        if isinstance(self.encoder, TextEncoder):
            return self.encoder(tokens, positions, observation.text), positions
        return self.encoder(tokens, positions), positions
