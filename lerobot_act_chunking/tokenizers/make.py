"""From a `TokenizerSpec` to a tokenizer."""

from typing import Any

from act_chunking_runtime.number_checks import check_at_least
from lerobot_act_chunking.errors import look_up
from lerobot_act_chunking.ranges import check_ranges
from lerobot_act_chunking.tokenizers.dct import DctTokenizer
from lerobot_act_chunking.tokenizers.fsq import FsqTokenizer
from lerobot_act_chunking.tokenizers.residual_vq import ResidualVqTokenizer
from lerobot_act_chunking.tokenizers.spec import TokenizerSpec
from lerobot_act_chunking.tokenizers.tokenizer import ActionTokenizer
from lerobot_act_chunking.tokenizers.uniform import UniformTokenizer

TOKENIZERS: dict[str, type[ActionTokenizer]] = {
    "residual_vq": ResidualVqTokenizer,
    "fsq": FsqTokenizer,
    "uniform": UniformTokenizer,
    "dct": DctTokenizer,
}
"""The tokenizers. What is listed here can be asked for as ``tokenizer``."""


def check_tokenizer(spec: TokenizerSpec) -> None:
    """Refuse values that cannot work.

    Raises:
        ConfigurationError: naming the value and the way out.
    """
    tokenizer = look_up("tokenizer", spec.tokenizer, TOKENIZERS)
    check_ranges(spec, "chunk_size")
    check_at_least(1, action_dim=spec.action_dim)
    tokenizer.check(spec)


def make_tokenizer(spec: TokenizerSpec) -> ActionTokenizer:
    """A fresh tokenizer.

    Raises:
        ConfigurationError: naming a value that cannot work.
    """
    check_tokenizer(spec)
    return TOKENIZERS[spec.tokenizer].from_spec(spec)


def building_settings(spec: TokenizerSpec) -> dict[str, Any]:
    """The settings that a trained tokenizer needs to be rebuilt; the others only say how it learned."""
    names = ("tokenizer", "chunk_size", *TOKENIZERS[spec.tokenizer].settings)
    return {name: getattr(spec, name) for name in names}
