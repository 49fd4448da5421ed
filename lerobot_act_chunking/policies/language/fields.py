"""The settings of instructions, under the same names in every policy of this package."""

from dataclasses import dataclass, field
from typing import Any

from lerobot.utils.constants import OBS_LANGUAGE

from lerobot_act_chunking.errors import ConfigurationError, DatasetError
from lerobot_act_chunking.nn.instruction import READERS
from lerobot_act_chunking.policies.choices import one_of

INSTRUCTION = OBS_LANGUAGE
"""Under what name the vector of an instruction is among the observations."""


@dataclass
class KnownInstructions:
    """What a checkpoint remembers of the instructions that it was trained with.

    Attributes:
        encoder: SHA-256 of the sentence encoder's weights and vocabulary.
        tasks: the instructions.
    """

    encoder: str
    tasks: list[str] = field(default_factory=list)


@dataclass
class LanguageFields:
    """Mixin for policy configurations: whether and how a policy reads its ``task``.

    Attributes:
        language_encoder: follow the ``task``, as read by this frozen sentence encoder: ``minilm`` (extra
            ``language``), or a folder or name of any text encoder that transformers loads. ``null`` ignores
            it. Checkpoints hold the encoder's name and digest, not its weights.
        language_reading: attend to each word's state (``words``), or take the ``mean`` of the words, which
            hardly tells "from left to right" from "from right to left".
        language_tokens: tokens of the longest instruction; more are cut, which is warned of.
        language_dropout: how often training leaves the instruction out. ``guidance_scale`` of
            ``diffusion_chunked`` needs it.
        instructions: not a setting: the encoder's digest and the instructions of the training, which fills it
            in.
    """

    language_encoder: str | None = None
    language_reading: str = one_of(READERS, "words")
    language_tokens: int = 32
    language_dropout: float = 0.0
    instructions: KnownInstructions | None = None

    def check_language(self) -> None:
        """Refuse a dropout of instructions that are not read."""
        if self.language_dropout and self.language_encoder is None:
            raise ConfigurationError(
                f"language_dropout={self.language_dropout} leaves out instructions, but the policy reads "
                "none: set --policy.language_encoder=minilm, or --policy.language_dropout=0"
            )

    @property
    def task_tokens(self) -> tuple[str, int] | None:
        """The encoder whose tokens of the task are read, and how many at most; None if none are."""
        return None if self.language_encoder is None else (self.language_encoder, self.language_tokens)

    @property
    def instruction_dropout(self) -> float:
        """How often training leaves the instruction out by itself, apart from what guidance leaves out."""
        return self.language_dropout


def tasks_of(meta: Any) -> list[str]:
    """The instructions of a dataset.

    Args:
        meta: LeRobot's metadata of it.

    Raises:
        DatasetError: there are none, or one is empty.
    """
    tasks = [] if meta.tasks is None else [str(each) for each in meta.tasks.index]
    if not tasks or not all(each.strip() for each in tasks):
        what = "an empty task" if tasks else "no tasks"
        raise DatasetError(
            f"language_encoder reads the task of each episode, but {meta.root} has {what}: write one with "
            f"lerobot-edit-dataset --repo_id={meta.repo_id} --root={meta.root} "
            "--operation.type=modify_tasks --operation.new_task='...', or train without "
            "--policy.language_encoder"
        )
    return tasks
