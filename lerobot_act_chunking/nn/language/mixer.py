"""An MLP-Mixer with as many weights as BERT, for the comparison of architectures."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from lerobot_act_chunking.nn.dropout import Dropout
from lerobot_act_chunking.nn.language.encoder import TextEncoder, TextEncoderSpec
from lerobot_act_chunking.nn.language.text import Text
from lerobot_act_chunking.nn.layers import FeedForward, LayerSpec, Residual

TOKEN_HIDDEN = 64
"""Hidden width of the MLP over tokens."""


def matched_width(spec: TextEncoderSpec) -> int:
    """Hidden width of the MLP over channels that gives a layer the weights of BERT's.

    The MLP over tokens comes on top: a few thousand of a million.
    """
    attention = 4 * spec.dim**2 + 3 * spec.dim
    return spec.dim_feedforward + round(attention / (2 * spec.dim + 1))


class MixerEncoder(TextEncoder):
    """Mixes tokens, then channels (Tolstikhin et al. 2021), with norms behind the branches as in BERT.

    Tokens have fixed places: those of the word pieces, then those of the robot. What was learned of the
    former from text alone is of use with any robot.
    """

    def _layer(self) -> "MixerLayer":
        spec = self.spec
        wide = LayerSpec(spec.dim, spec.n_heads, matched_width(spec), spec.dropout, "gelu", pre_norm=False)
        return MixerLayer(wide, spec.text_tokens if spec.vocabulary else 0, spec.n_robot_tokens)

    def _fitted(self, text: Text) -> Text:
        return text.filled_up(self.spec.text_tokens)

    def _through(
        self, layer: nn.Module, x: Float[Tensor, "B N D"], is_pad: Bool[Tensor, "B N"] | None
    ) -> Float[Tensor, "B N D"]:
        return layer(x, is_pad)


class MixerLayer(nn.Module):
    """One layer; padding adds nothing to other tokens."""

    def __init__(self, spec: LayerSpec, n_text: int, n_robot: int):
        super().__init__()
        self.mix = TokenMixing(spec, n_text, n_robot)
        self.refine = FeedForward(spec)

    def forward(
        self, x: Float[Tensor, "B N D"], is_pad: Bool[Tensor, "B N"] | None
    ) -> Float[Tensor, "B N D"]:
        """Refine all tokens; those of the robot are the last ones, and may be absent."""
        return self.refine(self.mix(x, is_pad))


class TokenMixing(Residual):
    """An MLP over the tokens of each channel, with weights for the two kinds of tokens apart."""

    def __init__(self, spec: LayerSpec, n_text: int, n_robot: int):
        super().__init__(spec)
        self.n_text = n_text
        self.text_in = nn.Linear(n_text, TOKEN_HIDDEN, bias=False) if n_text else None
        self.text_out = nn.Linear(TOKEN_HIDDEN, n_text) if n_text else None
        self.robot_in = nn.Linear(n_robot, TOKEN_HIDDEN, bias=False) if n_robot else None
        self.robot_out = nn.Linear(TOKEN_HIDDEN, n_robot) if n_robot else None
        self.bias = nn.Parameter(torch.zeros(TOKEN_HIDDEN))
        self.activation = nn.Sequential(nn.GELU(), Dropout(spec.dropout))

    def forward(
        self, x: Float[Tensor, "B N D"], is_pad: Bool[Tensor, "B N"] | None
    ) -> Float[Tensor, "B N D"]:
        """Add to each token what the others tell."""
        return self.add(x, lambda y: self._mixed(y, is_pad))

    def _mixed(self, x: Tensor, is_pad: Tensor | None) -> Tensor:
        seen = x if is_pad is None else x * ~is_pad[..., None]
        n_text = self.n_text if is_pad is not None else 0
        text, robot = seen[:, :n_text].transpose(1, 2), seen[:, n_text:].transpose(1, 2)
        hidden, outputs = self.bias, []
        if self.text_in is not None and self.text_out is not None and text.shape[2]:
            hidden = hidden + self.text_in(text)
            outputs.append(self.text_out)
        if self.robot_in is not None and self.robot_out is not None and robot.shape[2]:
            hidden = hidden + self.robot_in(robot)
            outputs.append(self.robot_out)
        hidden = self.activation(hidden)
        return torch.cat([out(hidden) for out in outputs], dim=2).transpose(1, 2)
