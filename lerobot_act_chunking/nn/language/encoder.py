"""An encoder whose body can start from a language model."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from lerobot_act_chunking.nn.dropout import Dropout
from lerobot_act_chunking.nn.language.text import Text
from lerobot_act_chunking.nn.layers import LayerSpec
from lerobot_act_chunking.nn.transformer import EncoderLayer

EPS, INITIAL_STD = 1e-12, 0.02
TEXT, ROBOT = 0, 1
"""Token types: of an instruction, as in BERT's first sentence, and of what the robot observes."""


@dataclass(frozen=True)
class TextEncoderSpec:
    """Sizes of an encoder.

    Attributes:
        dim: token width D.
        n_heads: attention heads; divides ``dim``.
        dim_feedforward: hidden width of the feed-forward branch.
        n_layers: layers.
        dropout: probability, as in BERT.
        vocabulary: word pieces that it knows; 0 for an encoder that reads no text.
        text_tokens: word pieces of the longest instruction.
        n_robot_tokens: tokens of an observation; only the mixer has to know.
    """

    dim: int
    n_heads: int
    dim_feedforward: int
    n_layers: int
    dropout: float
    vocabulary: int
    text_tokens: int
    n_robot_tokens: int

    @property
    def layers(self) -> LayerSpec:
        """Of one layer: exact GELU, norms behind the branches."""
        return LayerSpec(self.dim, self.n_heads, self.dim_feedforward, self.dropout, "gelu", pre_norm=False)


class TextEncoder(nn.Module, ABC):
    """Robot tokens behind the word pieces of an instruction, which all look at each other.

    Word pieces are embedded as in BERT. Robot tokens, with their own positions and a token type, go through a
    norm of their own that starts as that of the word pieces, so that the body finds both at one scale.
    """

    def __init__(self, spec: TextEncoderSpec):
        super().__init__()
        self.spec = spec
        self.types = nn.Embedding(2, spec.dim)
        self.robot_norm = nn.LayerNorm(spec.dim)
        self.dropout = Dropout(spec.dropout)
        reads = spec.vocabulary > 0
        self.words = nn.Embedding(spec.vocabulary, spec.dim) if reads else None
        self.places = nn.Embedding(spec.text_tokens, spec.dim) if reads else None
        self.norm = nn.LayerNorm(spec.dim) if reads else None
        self.layers = nn.ModuleList(self._layer() for _ in range(spec.n_layers))
        for module in self.modules():
            if isinstance(module, nn.LayerNorm):
                module.eps = EPS
            elif isinstance(module, nn.Linear | nn.Embedding):
                nn.init.normal_(module.weight, std=INITIAL_STD)
            if isinstance(module, nn.Linear) and module.bias is not None:
                nn.init.zeros_(module.bias)

    @abstractmethod
    def _layer(self) -> nn.Module:
        """One layer of the body."""

    @abstractmethod
    def _through(
        self, layer: nn.Module, x: Float[Tensor, "B N D"], is_pad: Bool[Tensor, "B N"] | None
    ) -> Float[Tensor, "B N D"]:
        """What a layer of the body makes of all tokens."""

    def forward(
        self, x: Float[Tensor, "B N D"], positions: Float[Tensor, "N D"], text: Text | None = None
    ) -> Float[Tensor, "B N D"]:
        """The robot's tokens, after they have looked at each other and at the instruction."""
        robot = self.dropout(self.robot_norm(x + positions + self.types.weight[ROBOT]))
        is_pad = None
        if text is not None:
            text = self._fitted(text)
            robot = torch.cat((self._embed(text), robot), dim=1)
            is_pad = nn.functional.pad(text.is_pad, (0, x.shape[1]), value=False)
        for layer in self.layers:
            robot = self._through(layer, robot, is_pad)
        return robot[:, -x.shape[1] :]

    def read(self, text: Text) -> list[Float[Tensor, "B L D"]]:
        """States of the word pieces alone: embedded, and after each layer, as a sentence encoder has them."""
        length = text.tokens.shape[1]
        text = self._fitted(text)
        states = [self._embed(text)]
        for layer in self.layers:
            states.append(self._through(layer, states[-1], text.is_pad))
        return [state[:, :length] for state in states]

    def _fitted(self, text: Text) -> Text:
        """The text in as many tokens as the body takes."""
        return text

    def _embed(self, text: Text) -> Float[Tensor, "B L D"]:
        assert self.words is not None  # noqa: S101
        assert self.places is not None  # noqa: S101
        assert self.norm is not None  # noqa: S101
        places = self.places.weight[: text.tokens.shape[1]]
        return self.dropout(self.norm(self.words(text.tokens) + places + self.types.weight[TEXT]))


class BertEncoder(TextEncoder):
    """BERT's layers (Devlin et al. 2019). Keys have no bias: the softmax removes what it adds."""

    def _layer(self) -> EncoderLayer:
        return EncoderLayer(self.spec.layers)

    def _through(
        self, layer: nn.Module, x: Float[Tensor, "B N D"], is_pad: Bool[Tensor, "B N"] | None
    ) -> Float[Tensor, "B N D"]:
        return layer(x, x.new_zeros(x.shape[1:]), is_pad)
