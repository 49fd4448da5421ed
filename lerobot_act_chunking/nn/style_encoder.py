"""The style encoder of ACT's conditional VAE: which of several ways to act this demonstration took."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F  # noqa: N812
from jaxtyping import Bool, Float
from torch import Tensor, nn

from lerobot_act_chunking.nn.cpu.span import Span, embedded, join
from lerobot_act_chunking.nn.layers import LayerSpec
from lerobot_act_chunking.nn.positions import sequence_positions
from lerobot_act_chunking.nn.transformer import Encoder


@dataclass(frozen=True)
class StyleInput:
    """What a style encoder sees of a demonstration.

    Attributes:
        chunk_size: T.
        action_dim: A.
        state_dim: S of the joint state; None if it is not seen.
        n_vector_tokens: observation tokens that are seen one by one; all behind them (those of cameras) are
            seen as their mean. None: no observation tokens, as in ACT.
        action_stride: actions that share a token, which sees their mean. Tokens are most of the cost of the
            VAE, and a style takes more than a few steps.
    """

    chunk_size: int
    action_dim: int
    state_dim: int | None
    n_vector_tokens: int | None = None
    action_stride: int = 1

    @property
    def n_tokens(self) -> int:
        """Most tokens there can be: class, state, actions, vectors and the mean of the cameras."""
        n_observed = 0 if self.n_vector_tokens is None else self.n_vector_tokens + 1
        return 1 + (self.state_dim is not None) + -(-self.chunk_size // self.action_stride) + n_observed


class StyleEncoder(nn.Module):
    """q(z | actions, observation) from a class token, the joint state, the action chunk, and more if asked.

    Source: ACT (Zhao et al. 2023), section IV-C. Only the class token is read, so the last layer computes
    only it.

    Args:
        spec: of the transformer's layers.
        sees: its input.
        n_layers: of the transformer.
        latent_dim: width L of a style.
        n_parameters: numbers P of the posterior.
    """

    def __init__(
        self, spec: LayerSpec, sees: StyleInput, *, n_layers: int, latent_dim: int, n_parameters: int
    ):
        super().__init__()
        self.sees = sees
        self.cls = nn.Parameter(torch.randn(spec.dim))
        self.state_proj = None if sees.state_dim is None else nn.Linear(sees.state_dim, spec.dim)
        self.action_proj = nn.Linear(sees.action_dim, spec.dim)
        self.token_proj = None if sees.n_vector_tokens is None else nn.Linear(spec.dim, spec.dim)
        self.encoder = Encoder(spec, n_layers)
        self.posterior_proj = nn.Linear(spec.dim, n_parameters)
        self.latent_proj = nn.Linear(latent_dim, spec.dim, bias=False)
        self.positions: Tensor
        self.register_buffer("positions", sequence_positions(sees.n_tokens, spec.dim), persistent=False)

    def forward(
        self,
        actions: Float[Tensor, "B T A"],
        is_pad: Bool[Tensor, "B T"],
        state: Float[Tensor, "B S"] | None,
        tokens: Float[Tensor, "B N D"] | None = None,
    ) -> Float[Tensor, "B P"]:
        """Parameters of the latent's posterior.

        Args:
            actions: normalised.
            is_pad: actions behind the episode's end, of which nothing is seen, NaN included.
            state: the current joint state.
            tokens: of the observation. They are detached, so that the KL term does not train the observation
                encoder.
        """
        actions, is_pad = pool_actions(actions, is_pad, self.sees.action_stride)
        before = is_pad.new_zeros(len(actions), 1 + (self.state_proj is not None))
        sequence = self._embed(actions, state)
        if self.token_proj is not None:
            sequence = torch.cat((sequence.tokens(), self.token_proj(self._observed(tokens))), dim=1)
        is_pad = torch.cat((before, is_pad), dim=1)
        n_tokens = (sequence.weights if isinstance(sequence, Span) else sequence).shape[1]
        is_pad = F.pad(is_pad, (0, n_tokens - is_pad.shape[1]))
        positions = self.positions[:n_tokens]
        return self.posterior_proj(self.encoder(sequence, positions, is_pad, n_out=1)[:, 0])

    def _embed(self, actions: Float[Tensor, "B n A"], state: Float[Tensor, "B S"] | None) -> Span:
        """Class token, state and actions as combinations of the class token and the embeddings' columns."""
        parts = [Span(torch.ones_like(actions[:, :1, :1]), self.cls[None])]
        if self.state_proj is not None and state is not None:
            parts.append(embedded(self.state_proj, state[:, None]))
        return join(*parts, embedded(self.action_proj, actions))

    def embed(self, latent: Float[Tensor, "B L"]) -> Float[Tensor, "B D"]:
        """What a latent adds to the policy's style token; nothing for the zero latent that ACT acts with."""
        return self.latent_proj(latent)

    def _observed(self, tokens: Float[Tensor, "B N D"] | None) -> Float[Tensor, "B n D"]:
        """Vectors one by one, then the mean of the cameras' tokens, if there are any."""
        if tokens is None:
            raise ValueError("this style encoder sees observation tokens, and none were passed")
        vectors, cells = tokens.detach().tensor_split((self.sees.n_vector_tokens or 0,), dim=1)
        return torch.cat((vectors, cells.mean(1, keepdim=True)), dim=1) if cells.shape[1] else vectors


def pool_actions(
    actions: Float[Tensor, "B T A"], is_pad: Bool[Tensor, "B T"], stride: int
) -> tuple[Float[Tensor, "B n A"], Bool[Tensor, "B n"]]:
    """Means of ``stride`` consecutive actions, over the valid ones; pads of windows that have none.

    The last window may be shorter. Pads are zero.
    """
    actions = actions.masked_fill(is_pad[..., None], 0)
    if stride == 1:
        return actions, is_pad
    missing = -actions.shape[1] % stride
    windows = F.pad(actions, (0, 0, 0, missing)).unflatten(1, (-1, stride))
    valid = (~F.pad(is_pad, (0, missing), value=True)).unflatten(1, (-1, stride))
    n_valid = valid.sum(-1, keepdim=True)
    return windows.sum(2) / n_valid.clamp_min(1), n_valid[..., 0] == 0
