"""Encoders by name, and which of their weights learn."""

from typing import Literal

from lerobot_act_chunking.nn.language.encoder import BertEncoder, TextEncoder, TextEncoderSpec
from lerobot_act_chunking.nn.language.lora import LoraLinear, adapt
from lerobot_act_chunking.nn.language.mixer import MixerEncoder

ENCODERS: dict[str, type[TextEncoder]] = {"bert": BertEncoder, "mixer": MixerEncoder}
Learning = Literal["full", "frozen", "lora"]


def make_text_encoder(kind: str, spec: TextEncoderSpec, learning: Learning = "full") -> TextEncoder:
    """A fresh encoder.

    The robot's own norm always learns. The table of word pieces never does: demonstrations show a few dozen
    of its rows, and the others must not be left behind.
    """
    encoder = ENCODERS[kind](spec)
    if learning == "lora":
        adapt(encoder.layers)
    if learning != "full":
        encoder.requires_grad_(False)
        encoder.robot_norm.requires_grad_(True)
    if encoder.words is not None:
        encoder.words.requires_grad_(False)
    for module in encoder.modules():
        if isinstance(module, LoraLinear):
            module.down.requires_grad_(True)
            module.up.requires_grad_(True)
    return encoder


def body_parameters(encoder: TextEncoder) -> int:
    """Weights of an encoder's layers."""
    return sum(each.numel() for each in encoder.layers.parameters())
