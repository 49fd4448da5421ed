"""Freeing space: dropping revisions, and the blobs that no revision shows any more."""

import time
from dataclasses import dataclass
from pathlib import Path

from lerobot_act_chunking import durable_files
from lerobot_act_chunking.hub import files
from lerobot_act_chunking.hub.publishing import ABANDONED, delete_ref
from lerobot_act_chunking.hub.refusal import RefusedError
from lerobot_act_chunking.hub.repository import MAIN, Repository


@dataclass(frozen=True)
class Freed:
    """What a clean-up removed: revisions, blobs, bytes."""

    revisions: int
    blobs: int
    size: int


def delete_revision(repository: Repository, revision: str) -> Freed:
    """Drop a tag, a branch other than ``main``, or an unnamed revision, and free what only it showed.

    The caller holds the repository's lock.

    Raises:
        RefusedError: other branches or tags still name the revision.
    """
    by_name = revision in repository.refs()
    if by_name and repository.head(revision) is None:  # a damaged name shows nothing
        delete_ref(repository, revision, tag=revision in repository.tags())
        return _drop(repository, [])
    commit_id = repository.resolve(revision)
    names = {name for name, target in repository.refs().items() if target == commit_id}
    if not by_name and names:
        raise RefusedError(
            f"{revision} is still named by {', '.join(sorted(names))}; delete those names instead"
        )
    if by_name:
        delete_ref(repository, revision, tag=revision in repository.tags())
    return _drop(repository, [] if names - {revision} else [commit_id])


def delete_history(repository: Repository) -> Freed:
    """Drop every revision that no branch or tag names. The caller holds the repository's lock."""
    named = set(repository.refs().values())
    if repository.head(MAIN) is None:
        raise repository.damaged(
            f"{MAIN!r} of {repository.name.repo_id!r} is damaged, so nothing may be dropped"
        )
    return _drop(repository, [commit_id for commit_id in repository.revisions() if commit_id not in named])


def shown_blobs(repository: Repository) -> set[str]:
    """The names of the blobs that some revision shows."""
    return {name for commit_id in repository.revisions() for name in _blobs_of(repository, commit_id)}


def unreferenced_blobs(repository: Repository) -> list[Path]:
    """The blobs that no revision shows: pushes under way, or ones that were killed."""
    shown = shown_blobs(repository)
    if not repository.blobs.is_dir():
        return []
    return sorted(path for path in repository.blobs.iterdir() if path.name not in shown)


def _blobs_of(repository: Repository, commit_id: str) -> set[str]:
    listed = {repository.blob_name(commit_id, path) for path in repository.snapshot_files(commit_id)} - {None}
    if (repository.commit_folder / f"{commit_id}.json").is_file():
        # Without symlinks the snapshot does not say which blob a file is; the description does.
        try:
            listed |= {entry.digest for entry in repository.commit(commit_id).files.values()}
        except RefusedError:
            if not listed:
                raise
    return {name for name in listed if name is not None}


def _drop(repository: Repository, commit_ids: list[str]) -> Freed:
    dropped_at: dict[str, float] = {}
    for commit_id in commit_ids:
        moment = _described_at(repository, commit_id)
        for name in _blobs_of(repository, commit_id):
            dropped_at[name] = max(moment, dropped_at.get(name, 0.0))
    for commit_id in commit_ids:
        with durable_files.scratch_path(repository.incoming) as trash:
            durable_files.publish(repository.snapshots / commit_id, trash)
        durable_files.remove(repository.commit_folder / f"{commit_id}.json")
    freed = [
        path
        for path in unreferenced_blobs(repository)
        if not _in_flight(path, dropped_at.get(path.name, 0.0))
    ]
    size = sum(path.lstat().st_size for path in freed)
    files.remove_abandoned(repository.incoming, ABANDONED)
    for path in freed:
        durable_files.remove(path)
    return Freed(len(commit_ids), len(freed), size)


def _described_at(repository: Repository, commit_id: str) -> float:
    description = repository.commit_folder / f"{commit_id}.json"
    return (description if description.is_file() else repository.snapshots / commit_id).stat().st_mtime


def _in_flight(blob: Path, dropped_at: float) -> bool:
    """Whether a push announced the blob not long ago, after the newest dropped revision that showed it."""
    announced = blob.lstat().st_mtime
    return announced > dropped_at and time.time() - announced < ABANDONED
