"""The instructions of a policy's samples: each is encoded once, and a change of them is noticed."""

import difflib
import logging
from collections import OrderedDict
from collections.abc import Mapping
from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float, Int64
from lerobot.utils.constants import OBS_LANGUAGE_ATTENTION_MASK, OBS_LANGUAGE_TOKENS
from torch import Tensor

from lerobot_act_chunking.errors import ConfigurationError, FeatureError
from lerobot_act_chunking.policies.language.encoder import SentenceEncoder, load_encoder
from lerobot_act_chunking.policies.language.fields import KnownInstructions, LanguageFields, tasks_of

REMEMBERED = 1024  # instructions; 48 kB each with the default encoder

logger = logging.getLogger(__name__)


class EncodedInstructions(NamedTuple):
    """Instructions, each different one once.

    Attributes:
        states: (n, L, E), what the encoder says of each word.
        mask: (n, L), which words there are.
        rows: (B,), which instruction each sample has.
    """

    states: Float[Tensor, "n L E"]
    mask: Bool[Tensor, "n L"]
    rows: Int64[Tensor, " B"]


class InstructionEncoder:
    """Encodes the instructions of LeRobot's batches, each different one once.

    Args:
        config: of the policy; what it knows of instructions is filled in.
        meta: LeRobot's metadata of the dataset that it is trained on, if it is.

    Raises:
        ConfigurationError: the encoder is not to be had, reads less than asked for, or is another one than
            the policy was trained with.
        DatasetError: the dataset has no instructions.

    Attributes:
        tasks: instructions of the training.
    """

    def __init__(self, config: LanguageFields, meta: Any | None = None):
        assert config.language_encoder is not None  # noqa: S101 (asked by the caller)
        self.encoder: SentenceEncoder = load_encoder(config.language_encoder)
        self._most = config.language_tokens
        self._known: OrderedDict[tuple[int, ...], Tensor] = OrderedDict()
        self._check(config)
        known = config.instructions
        tasks = tasks_of(meta) if meta is not None else (known.tasks if known else [])
        config.instructions = KnownInstructions(self.encoder.digest, tasks)
        self.tasks = tasks
        self._seen: set[tuple[int, ...]] | None = None
        self._told = False
        if meta is not None and len(tasks) == 1:
            logger.warning("all episodes have one task, %r: instructions decide nothing", tasks[0])

    def _check(self, config: LanguageFields) -> None:
        encoder = self.encoder
        if self._most > encoder.longest:
            raise ConfigurationError(
                f"language_tokens={self._most}, but language_encoder={encoder.name} reads {encoder.longest} "
                f"tokens: set --policy.language_tokens={encoder.longest} or less"
            )
        trained_with = config.instructions
        if trained_with is not None and trained_with.encoder != encoder.digest:
            raise ConfigurationError(
                f"language_encoder={encoder.name} is not the sentence encoder that the policy was trained "
                f"with: its digest is {encoder.digest[:12]}, that of the training {trained_with.encoder[:12]}"
                ". Give the encoder of the training with --policy.language_encoder"
            )

    def encode_tasks(self) -> EncodedInstructions:
        """All instructions of the training."""
        tokens = [tuple(self.encoder.tokens(task, self._most)) for task in self.tasks]
        return self._encoded(tokens, torch.device("cpu"))

    def encode(self, batch: Mapping[str, Any], *, acting: bool = False) -> EncodedInstructions:
        """The instructions of a batch.

        Args:
            batch: LeRobot's, with ``observation.language.tokens`` (B, L) and their mask.
            acting: whether to warn, once, of an instruction that training had not.

        Raises:
            FeatureError: the batch has no tokens, or they are ill-shaped.
        """
        tokens, mask = self._taken(batch)
        listed, words = tokens.tolist(), mask.sum(1).tolist()
        said = [tuple(row[:n]) for row, n in zip(listed, words, strict=True)]
        if acting and not self._told and self.tasks:
            self._warn_of_new(said)
        return self._encoded(said, tokens.device)

    def _taken(self, batch: Mapping[str, Any]) -> tuple[Tensor, Tensor]:
        tokens, mask = batch.get(OBS_LANGUAGE_TOKENS), batch.get(OBS_LANGUAGE_ATTENTION_MASK)
        if not isinstance(tokens, Tensor) or not isinstance(mask, Tensor):
            raise FeatureError(
                f"the policy follows instructions, but the batch has no {OBS_LANGUAGE_TOKENS!r}: its "
                "preprocessor makes them of the task; one that was made without language_encoder cannot"
            )
        if tokens.ndim != 2 or tokens.shape != mask.shape:
            raise FeatureError(
                f"{OBS_LANGUAGE_TOKENS!r} has shape {tuple(tokens.shape)} and its mask {tuple(mask.shape)}, "
                "expected (B, L) for both"
            )
        return tokens, mask

    def _encoded(self, said: list[tuple[int, ...]], device: torch.device) -> EncodedInstructions:
        different = list(dict.fromkeys(said))
        states = torch.zeros(len(different), self._most, self.encoder.width)
        mask = torch.zeros(len(different), self._most, dtype=torch.bool)
        for row, tokens in enumerate(different):
            states[row, : len(tokens)] = self._states(tokens)
            mask[row, : len(tokens)] = True
        places = {tokens: row for row, tokens in enumerate(different)}
        rows = torch.tensor([places[tokens] for tokens in said])
        return EncodedInstructions(states.to(device), mask.to(device), rows.to(device))

    def _states(self, tokens: tuple[int, ...]) -> Float[Tensor, "L E"]:
        if tokens not in self._known:
            self._known[tokens] = self.encoder.states(list(tokens))
            if len(self._known) > REMEMBERED:
                self._known.popitem(last=False)
        self._known.move_to_end(tokens)
        return self._known[tokens]

    def _warn_of_new(self, said: list[tuple[int, ...]]) -> None:
        if self._seen is None:
            self._seen = {tuple(self.encoder.tokens(task, self._most)) for task in self.tasks}
        new = next((tokens for tokens in said if tokens not in self._seen), None)
        if new is None:
            return
        self._told = True
        text = self.encoder.text(list(new))
        (nearest,) = difflib.get_close_matches(text, self.tasks, 1, 0.0)
        logger.warning(
            "the task %r was not among the %d of the training; the nearest of those is %r",
            text,
            len(self.tasks),
            nearest,
        )
