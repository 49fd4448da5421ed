"""Restoring what a repository's own contents can restore, without deleting anything."""

import contextlib
import os
import uuid
from pathlib import Path

from lerobot_act_chunking import durable_files
from lerobot_act_chunking.hub import files, publishing
from lerobot_act_chunking.hub.commits import Commit, Entry
from lerobot_act_chunking.hub.names import is_digest, is_sha256
from lerobot_act_chunking.hub.refusal import RefusedError
from lerobot_act_chunking.hub.repository import MAIN, Repository
from lerobot_act_chunking.hub.verifying import Checksums, lacks_main, misplaced, stray_refs


def repair(repository: Repository) -> list[str]:
    """Rebuild folders, links and names from descriptions and blobs; the caller holds the repository's lock.

    What is damaged or in the way is moved to a folder ``.hub-aside-…`` of the repository. Contents that
    are lost have to be pushed again, before or after.

    Returns:
        What was done, a line each.
    """
    return _Repair(repository).run()


class _Repair:
    def __init__(self, repository: Repository):
        self.repository = repository
        self.checksums = Checksums(repository)
        self.aside = repository.folder / f".hub-aside-{uuid.uuid4().hex[:8]}"
        self.done: list[str] = []

    def run(self) -> list[str]:
        repository = self.repository
        while found := misplaced(repository):  # whatever hides behind the first is seen after it
            for path in found:
                self._set_aside(path, "was not a folder")
        self._descriptions()
        for commit_id in repository.described():
            self._revision(commit_id)
        for commit_id in set(repository.revisions()) - set(repository.described()):
            self._undescribed(commit_id)
        self._refs()
        return self.done

    def _set_aside(self, path: Path, why: str) -> None:
        target = self.aside / path.relative_to(self.repository.folder)
        durable_files.publish(path, target)
        self.done.append(f"{path} {why}; it is now {target}")

    def _descriptions(self) -> None:
        for commit_id in self.repository.described():
            try:
                self.repository.description(commit_id)
            except RefusedError:
                self._set_aside(self.repository.commit_folder / f"{commit_id}.json", "was damaged")

    def _revision(self, commit_id: str) -> None:
        repository, commit = self.repository, self.repository.description(commit_id)
        named = commit_id in repository.refs().values()
        if not repository.has_revision(commit_id):
            if not named and not all(repository.has_blob(entry) for entry in commit.files.values()):
                return
            (repository.snapshots / commit_id).mkdir(parents=True)
            self.done.append(f"revision {commit_id} has its folder again")
        for path in sorted(set(repository.snapshot_files(commit_id)) - set(commit.files)):
            self._set_aside(repository.snapshots / commit_id / path, f"was no part of revision {commit_id}")
        for path, entry in commit.files.items():
            self._content(commit_id, path, entry)
            self._shown(commit_id, path, entry)

    def _content(self, commit_id: str, path: str, entry: Entry) -> None:
        blob, shown = self.repository.blob(entry.digest), self.repository.snapshots / commit_id / path
        self._blob(blob, entry.digest, entry.size)
        copied = self.checksums.fault_of(shown, entry.digest, entry.size) is None
        if copied and not blob.exists() and is_sha256(entry.digest):
            publishing.receive_blob(self.repository, files.read_chunks(shown), entry.digest, entry.size)

    def _blob(self, blob: Path, digest: str, size: int | None = None) -> None:
        fault = self.checksums.fault_of(blob, digest, size)
        if fault is not None and os.path.lexists(blob):
            self._set_aside(blob, fault)

    def _shown(self, commit_id: str, path: str, entry: Entry) -> None:
        repository, shown = self.repository, self.repository.snapshots / commit_id / path
        fault = self.checksums.fault_of(shown, entry.digest, entry.size)
        if fault is None or repository.blob_name(commit_id, path) == entry.digest:
            return
        if os.path.lexists(shown):
            self._set_aside(shown, fault)
        shown.parent.mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(FileNotFoundError):  # without symlinks a lost content cannot be shown
            files.place(
                repository.blob(entry.digest), shown, publishing.link_from(repository.snapshots, shown, entry)
            )
            self.done.append(f"{shown} shows its content again")

    def _undescribed(self, commit_id: str) -> None:
        for path in self.repository.snapshot_files(commit_id):
            digest = self.repository.blob_name(commit_id, path)
            shown = self.repository.snapshots / commit_id / path
            if digest is not None and is_digest(digest):
                self._blob(self.repository.blob(digest), digest)
            elif fault := self.checksums.fault_of(shown, None):
                self._set_aside(shown, fault)

    def _refs(self) -> None:
        repository = self.repository
        for name in stray_refs(repository):
            self._set_aside(repository.ref_folder / name, "was no branch or tag")
        for name, said in repository.refs().items():
            if repository.has_revision(said):
                continue
            self._set_aside(repository.ref_folder / name, f"named {said!r}, which is no revision")
            if repository.has_revision(said.strip()):
                self._point(name, said.strip())
        for name in repository.tag_marks() - set(repository.refs()):
            self._set_aside(repository.tag_folder / name, "marked a tag that is gone")
        if lacks_main(repository):
            self._point(MAIN, self._newest())

    def _point(self, name: str, commit_id: str) -> None:
        path = self.repository.ref_folder / name
        if path.is_dir():
            self._set_aside(path, "was a folder")
        publishing.point(self.repository, name, commit_id)
        self.done.append(f"{name!r} names revision {commit_id}")

    def _newest(self) -> str:
        """The newest revision that none builds on and no other branch names; an empty one if none is left."""
        repository = self.repository
        commits = {commit_id: repository.description(commit_id) for commit_id in repository.described()}
        named = {said for name, said in repository.refs().items() if name not in repository.tags()}
        inner = named | {commit.parent for commit in commits.values()}
        revisions = repository.revisions()
        tips = [commit_id for commit_id in revisions if commit_id not in inner] or revisions
        if not tips:
            empty = Commit.now(title="started anew", description="", parent=None, files={})
            publishing.write_snapshot(repository, empty, None)
            return empty.commit_id
        dates = {commit_id: commit.date for commit_id, commit in commits.items()}
        # Among revisions without a description, that whose folder is the newest.
        return max(reversed(tips), key=lambda commit_id: dates.get(commit_id, ""))
