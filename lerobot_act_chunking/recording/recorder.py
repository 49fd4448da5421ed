"""From a source of episodes to a complete LeRobotDataset, through any number of interruptions."""

import shutil
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.executors import Cluster, Executor
from lerobot_act_chunking.recording.attempts import AttemptQueue
from lerobot_act_chunking.recording.episode import Episode, EpisodeSource
from lerobot_act_chunking.recording.full_disk import explain_full_disk
from lerobot_act_chunking.recording.runners import StoringRunner, open_attempts
from lerobot_act_chunking.recording.shares import ONE_WAY
from lerobot_act_chunking.recording.staging import Staging, differences, open_staging, staging_folder
from lerobot_act_chunking.recording.summary import (
    SUMMARY_PATH,
    RecordedEpisode,
    RecordingSummary,
    read_summary,
)

# Keeps workers busy while the recorder imports LeRobot or encodes a video, and bounds what it holds of them.
_QUEUED_PER_WORKER = 4


@dataclass(frozen=True)
class Target:
    """Which dataset to make: its folder, its name for LeRobot, how many episodes, from which seed on."""

    root: Path
    repo_id: str
    episodes: int
    first_seed: int = 0


@dataclass(frozen=True)
class RecordingProgress:
    """How far a recording is: episodes in the dataset, failed attempts, episodes wanted."""

    recorded: int
    failed: int
    total: int


@dataclass(frozen=True)
class RecordResult:
    """A complete dataset.

    Attributes:
        root: its folder.
        episodes: episodes in it.
        frames: frames in it.
        attempts: episodes that were played for it.
        seconds: wall time of this call.
        already_complete: the dataset was there before the call.
        operators: attempts of each person who demonstrated, discarded and in all.
        modes: attempts of each way of doing the task, discarded and in all, where there are several.
    """

    root: Path
    episodes: int
    frames: int
    attempts: int
    seconds: float
    already_complete: bool
    operators: dict[str, tuple[int, int]] = field(default_factory=dict)
    modes: dict[int, tuple[int, int]] = field(default_factory=dict)

    @property
    def expert_success_rate(self) -> float:
        """Share of attempts that succeeded."""
        return self.episodes / self.attempts


def record_source(
    source: EpisodeSource,
    target: Target,
    *,
    workers: int = 1,
    cluster: Cluster | None = None,
    progress: Callable[[RecordingProgress], None] = lambda _: None,
) -> RecordResult:
    """Record the first ``target.episodes`` successes among consecutive seeds, or finish doing so.

    The dataset is the same, byte for byte, whatever the number of workers, however often the recording was
    interrupted, and whichever workers died. It appears under its name only when it is complete; until then
    finished episodes wait in a hidden folder beside it. A complete dataset does not grow: record more into
    another folder, from the next seed on, and merge the two with LeRobot.

    Args:
        source: where episodes come from; with ``shares`` (`ModeShares`), so many successes of each way.
        target: the dataset to make.
        workers: processes that play episodes; 1 plays them in this one.
        cluster: whose processes; by default this machine's.
        progress: called after every attempt.

    Raises:
        ConfigurationError: ``target.root`` holds something else or cannot be written, or the recording begun
            there had other settings.
        DatasetError: an episode that is not finite or ill-shaped, an expert that keeps failing, a full disk.
        WorkerError: workers died again and again.
    """
    start = time.monotonic()
    settings = {**source.settings, "first_seed": target.first_seed}
    summary = _published(target, settings)
    already_complete = summary is not None
    if summary is None:
        manifest = settings | {f"version of {name}": version for name, version in source.versions.items()}
        with (
            explain_full_disk(staging_folder(target.root)),
            open_staging(target.root, manifest) as staging,
            open_attempts(source, workers, cluster) as executor,
        ):
            summary = _record(source, target, settings, staging, executor, progress)
    return RecordResult(
        root=target.root,
        episodes=len(summary.episodes),
        frames=summary.frames,
        attempts=summary.attempts,
        seconds=time.monotonic() - start,
        already_complete=already_complete,
        operators=summary.operators,
        modes=summary.modes,
    )


def _record(
    source: EpisodeSource,
    target: Target,
    settings: dict[str, Any],
    staging: Staging,
    executor: Executor[int, Episode],
    progress: Callable[[RecordingProgress], None],
) -> RecordingSummary:
    recorded: list[RecordedEpisode] = []
    failed: list[int] = []
    known = staging.store.outcomes()
    runner = StoringRunner(executor, staging.store)
    ahead = 1 if executor.workers == 1 else executor.workers * _QUEUED_PER_WORKER
    shares = getattr(source, "shares", ONE_WAY)
    attempts = AttemptQueue(runner, known, target.first_seed, target.episodes, ahead, shares)
    # Imports LeRobot, which takes seconds: the workers are at work by now.
    from lerobot_act_chunking.recording.assembly import DatasetAssembly

    with DatasetAssembly(staging.dataset, target.repo_id, source.format) as assembly:
        for seed, success in attempts:
            if success:
                episode = staging.store.load(seed)
                assembly.add(episode)
                entry = RecordedEpisode(len(recorded), seed, success, len(episode), episode.details)
                recorded.append(entry)
            else:
                failed.append(seed)
            progress(RecordingProgress(len(recorded), len(failed), target.episodes))
        summary = RecordingSummary(settings, source.versions, tuple(failed), tuple(recorded))
        assembly.finish(asdict(summary))
        staging.publish()
    return summary


def _published(target: Target, settings: dict[str, Any]) -> RecordingSummary | None:
    """The summary of the very dataset asked for, None where nothing is yet, an error for anything else."""
    root = target.root
    if root.is_mount():
        raise ConfigurationError(f"{root} is a mount point; choose a folder inside it")
    if not root.exists() or (root.is_dir() and not any(root.iterdir())):
        return None
    if not (root / SUMMARY_PATH).exists():
        raise ConfigurationError(
            f"{root} already holds {_content(root)}; choose another root, or remove it to record there"
        )
    summary = read_summary(root)
    different = differences(summary.settings, settings)
    if different:
        raise ConfigurationError(
            f"{root} already holds a recording with other settings ({different}); choose another root"
        )
    if len(summary.episodes) != target.episodes:
        raise ConfigurationError(
            f"{root} is a complete recording of {len(summary.episodes)} episodes, "
            f"asked for {target.episodes}; record more into another root with --seed {summary.next_seed} "
            "and merge them with lerobot-edit-dataset, or remove it to start again"
        )
    shutil.rmtree(
        staging_folder(root), ignore_errors=True
    )  # a crash right after publication leaves it behind
    return summary


def _content(root: Path) -> str:
    if not root.is_dir():
        return "a file"
    if (root / "meta" / "info.json").exists():
        return "a LeRobot dataset that act-chunking did not record"
    names = sorted(path.name for path in root.iterdir())
    return f"something else ({', '.join(names[:3])}{', …' if len(names) > 3 else ''})"
