"""The checkpoints of an evaluation, each with its noise, and where its episodes are kept."""

import io
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_act_chunking.diagnostics.core.eval_info import EVAL_INFO
from lerobot_act_chunking.diagnostics.core.played import Episode
from lerobot_act_chunking.diagnostics.eval.episodes import Group
from lerobot_act_chunking.diagnostics.eval.playing import Played, Task
from lerobot_act_chunking.durable_files import write_atomically
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.json_files import read_json

QUESTION, GROUPS = "question.json", "groups"


@dataclass(frozen=True)
class Run:
    """One checkpoint with one draw of its noise.

    Attributes:
        name: of the recipe.
        training: which of its trainings, from 0 on; None if there is one.
        draw: which repetition, from 0 on; None if there is one.
        checkpoint: folder or repo id.
        policy_type: as ``--policy.type``.
        question: what its episodes depend on.
        folder: of its files.
    """

    name: str
    training: int | None
    draw: int | None
    checkpoint: str
    policy_type: str
    question: dict[str, Any]
    folder: Path

    @property
    def title(self) -> str:
        """Its name, with the training and the draw where there are several."""
        parts = [self.name]
        if self.training is not None:
            parts.append(f"training {self.training + 1}")
        if self.draw is not None:
            parts.append(f"draw {self.draw + 1}")
        return ", ".join(parts)

    @property
    def place(self) -> Path:
        """Of its folder, within that of the evaluation."""
        parts = [self.name.replace("/", "_")]
        if self.training is not None:
            parts.append(f"training_{self.training + 1}")
        if self.draw is not None:
            parts.append(f"draw_{self.draw + 1}")
        return Path(*parts)

    def task(self, number: int) -> Task:
        """A group of its episodes."""
        return Task(self.checkpoint, self.draw or 0, number)

    def open(self) -> None:
        """Make the folder, or see that it holds the episodes of this very question.

        Raises:
            ConfigurationError: it holds those of another, or is damaged.
        """
        check_question(self.folder, self.question)
        write_atomically(self.folder / QUESTION, _json(self.question))

    def groups(self, numbers: Sequence[int]) -> Iterator[tuple[int, Group]]:
        """The finished ones of these groups.

        Raises:
            ConfigurationError: a file is damaged.
        """
        for number in numbers:
            path = self._path(number, "json")
            if path.exists():
                try:
                    yield number, Group.from_json(read_json(path))
                except (ValueError, KeyError, TypeError) as error:
                    raise ConfigurationError(
                        f"{path} cannot be read ({error!r}): remove it, and its episodes run again"
                    ) from error

    def has(self, number: int) -> bool:
        """Whether a group is finished."""
        return self._path(number, "json").exists()

    def keep(self, number: int, played: Played) -> None:
        """Write a finished group down, its motion first."""
        motion = io.BytesIO()
        np.savez_compressed(motion, **played.motion)  # pyright: ignore[reportArgumentType]
        write_atomically(self._path(number, "npz"), motion.getvalue())
        write_atomically(self._path(number, "json"), _json(played.group.to_json()))

    def motion(self, number: int, place: int, kind: str) -> np.ndarray:
        """The ``commands`` (T, A) or ``states`` (T, S) of the group's episode ``place``."""
        with np.load(self._path(number, "npz")) as file:
            return file[f"{kind}_{place}"]

    def take_over(self, other: Path) -> int:
        """Copy the groups of another folder that are missing here; returns how many.

        Raises:
            ConfigurationError: they are the episodes of another question.
        """
        if not (other / QUESTION).exists():
            return 0
        check_question(other, self.question)
        taken = 0
        for path in sorted((other / GROUPS).glob("*.json")):
            if not (self.folder / GROUPS / path.name).exists():
                for each in (path.with_suffix(".npz"), path):
                    write_atomically(self.folder / GROUPS / each.name, each.read_bytes())
                taken += 1
        return taken

    def write_eval_info(
        self, episodes: Sequence[Episode], facts: dict[str, Any], *, is_judged: bool = True
    ) -> Path:
        """What ``lerobot-eval`` would have written of these episodes, and all that it would not.

        Args:
            episodes: in the order of their seeds.
            facts: about all of them.
            is_judged: whether anything is known of success; if not, it is null.
        """
        told = [(each.success, each.label) if is_judged else (None, None) for each in episodes]
        metrics = {
            "sum_rewards": [each.sum_reward for each in episodes],
            "max_rewards": [each.max_reward for each in episodes],
            "successes": [success for success, _ in told],
        }
        overall = {
            "avg_sum_reward": float(np.mean(metrics["sum_rewards"])),
            "avg_max_reward": float(np.mean(metrics["max_rewards"])),
            "pc_success": 100 * float(np.mean(metrics["successes"])) if is_judged else None,
            "n_episodes": len(episodes),
        }
        group = str(self.question["environment"]["type"])
        content = {
            "per_task": [{"task_group": group, "task_id": 0, "metrics": metrics}],
            "per_group": {group: overall},
            "overall": overall,
            "act_chunking": {
                **facts,
                "question": self.question,
                "episodes": [
                    {**vars(each), "success": success, "label": label}
                    for each, (success, label) in zip(episodes, told, strict=True)
                ],
            },
        }
        write_atomically(self.folder / EVAL_INFO, _json(content))
        return self.folder / EVAL_INFO

    def _path(self, number: int, kind: str) -> Path:
        return self.folder / GROUPS / f"{number:05d}.{kind}"


def check_question(folder: Path, question: dict[str, Any]) -> None:
    """Refuse a folder that holds the episodes of another question.

    Raises:
        ConfigurationError: naming what differs.
    """
    path = folder / QUESTION
    if not path.exists():
        return
    try:
        there = dict(read_json(path))
    except (ValueError, TypeError) as error:
        raise ConfigurationError(f"{path} cannot be read ({error!r}): choose another --output-dir") from error
    differing = sorted(name for name in {*there, *question} if there.get(name) != question.get(name))
    if differing:
        raise ConfigurationError(
            f"{folder} holds episodes of another {' and '.join(differing)}: choose another --output-dir"
        )


def _json(content: Any) -> bytes:
    return (json.dumps(content, indent=1, allow_nan=False) + "\n").encode()
