"""What a recording says about itself: ``meta/recording.json``.

LeRobot leaves unknown files in ``meta/`` alone, and pushes and downloads them with the dataset. Its dataset
editing (merge, split, delete episodes) makes new datasets without them. Columns in its own table of episodes
would survive that, but its writer takes none from outside.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lerobot_act_chunking.errors import DatasetError
from lerobot_act_chunking.json_files import read_json
from lerobot_act_chunking.recording.shares import ModeShares

SUMMARY_PATH = "meta/recording.json"


@dataclass(frozen=True)
class RecordedEpisode:
    """One episode of the dataset.

    Attributes:
        episode_index: LeRobot's index.
        seed: the seed it was played with.
        success: always true: failures are not recorded.
        frames: its length.
        details: what the source kept, such as the success rules met and the expert's options.
    """

    episode_index: int
    seed: int
    success: bool
    frames: int
    details: dict[str, Any]


@dataclass(frozen=True)
class RecordingSummary:
    """How a dataset was made.

    Attributes:
        settings: what the episodes depend on.
        versions: the packages they were made with.
        failed_seeds: seeds in between whose attempts failed.
        episodes: one entry per episode, in order.
    """

    settings: dict[str, Any]
    versions: dict[str, str]
    failed_seeds: tuple[int, ...]
    episodes: tuple[RecordedEpisode, ...]

    @property
    def frames(self) -> int:
        """Frames of all episodes."""
        return sum(episode.frames for episode in self.episodes)

    @property
    def attempts(self) -> int:
        """Episodes played to get the recorded ones."""
        return len(self.episodes) + len(self.failed_seeds)

    @property
    def operators(self) -> dict[str, tuple[int, int]]:
        """Attempts of each person who demonstrated, discarded and in all; empty without operators."""
        names = list(self.settings.get("operators", {}))
        return self._discarded(names, lambda seed: operator_of(names, seed))

    @property
    def modes(self) -> dict[int, tuple[int, int]]:
        """Attempts of each way of doing the task, discarded and in all; empty of a task with one way."""
        shares = ModeShares(tuple(self.settings.get("mode_shares", ())))
        return self._discarded(range(len(shares.percentages)), shares.mode_of)

    @property
    def next_seed(self) -> int:
        """The first seed after all that were played."""
        return 1 + max([*self.failed_seeds, *(episode.seed for episode in self.episodes)])

    def _discarded[Kind](
        self, kinds: Sequence[Kind], kind_of: Callable[[int], Kind]
    ) -> dict[Kind, tuple[int, int]]:
        if not kinds:
            return {}
        discarded = Counter(map(kind_of, self.failed_seeds))
        recorded = Counter(kind_of(episode.seed) for episode in self.episodes)
        return {kind: (discarded[kind], discarded[kind] + recorded[kind]) for kind in kinds}


def operator_of(operators: Sequence[str], seed: int) -> str:
    """Who demonstrates the episode of ``seed``: they take turns."""
    return operators[seed % len(operators)]


def read_summary(root: Path) -> RecordingSummary:
    """Read back how the dataset at ``root`` was recorded.

    Raises:
        DatasetError: no dataset there, or one that was not recorded by this package.
    """
    path = Path(root) / SUMMARY_PATH
    if not path.exists():
        raise DatasetError(f"{root} holds no dataset recorded by act-chunking ({SUMMARY_PATH} is missing)")
    try:
        content = read_json(path)
        return RecordingSummary(
            settings=content["settings"],
            versions=content["versions"],
            failed_seeds=tuple(content["failed_seeds"]),
            episodes=tuple(RecordedEpisode(**entry) for entry in content["episodes"]),
        )
    except (ValueError, KeyError, TypeError) as error:
        raise DatasetError(f"{path} is damaged ({error}); record the dataset again") from error
