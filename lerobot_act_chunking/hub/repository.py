"""Reading one repository folder: its refs, revisions and files. Writing lives in ``publishing``."""

import os
from collections.abc import Iterator
from pathlib import Path

from lerobot_act_chunking import durable_files
from lerobot_act_chunking.hub import files
from lerobot_act_chunking.hub.commits import Commit, Entry
from lerobot_act_chunking.hub.names import (
    RepoName,
    checked_path,
    checked_ref,
    is_commit,
    is_path,
    is_ref,
    is_short_commit,
)
from lerobot_act_chunking.hub.refusal import RefusedError, revision_not_found

MAIN = "main"
MAX_DESCRIPTION = 1 << 28
"""Longest description of a revision that is read [bytes]; a file takes about 150."""
LOST = -1
"""The size of a downloaded revision's file whose content is gone: that of no blob [bytes]."""
_OUR_FOLDER = ".hub"


class Repository:
    """One repository of the hub at ``root``."""

    def __init__(self, name: RepoName, root: Path):
        self.name = name
        self.root = root
        self.folder = root / name.folder
        self.blobs = self.folder / "blobs"
        self.snapshots = self.folder / "snapshots"
        self.ref_folder = self.folder / "refs"
        self.tag_folder = self.folder / _OUR_FOLDER / "tags"
        self.commit_folder = self.folder / _OUR_FOLDER / "commits"
        self.incoming = self.folder / _OUR_FOLDER / "incoming"
        files.require_inside(self.folder, root)
        for part in self.parts:
            files.require_inside(part, self.folder)

    @property
    def parts(self) -> list[Path]:
        """The folders that a repository consists of, outer ones first."""
        ours = [self.tag_folder.parent, self.tag_folder, self.commit_folder, self.incoming]
        return [self.blobs, self.snapshots, self.ref_folder, *ours]

    @staticmethod
    def initialise(folder: Path) -> None:
        """Lay out an empty repository: every folder, and one revision without files on ``main``."""
        for part in ("blobs", "refs", "snapshots", f"{_OUR_FOLDER}/tags", f"{_OUR_FOLDER}/incoming"):
            (folder / part).mkdir(parents=True)
        first = Commit.now(title="initial commit", description="", parent=None, files={})
        scratch = folder / _OUR_FOLDER / "incoming"
        durable_files.write_atomically(
            folder / _OUR_FOLDER / "commits" / f"{first.commit_id}.json", first.to_json(), scratch
        )
        (folder / "snapshots" / first.commit_id).mkdir()
        durable_files.write_atomically(folder / "refs" / MAIN, first.commit_id.encode(), scratch)

    def refs(self) -> dict[str, str]:
        """What every branch and tag says, by name; a damaged ref says something that is no revision."""
        return {name: self._said(self.ref_folder / name) for name in self.ref_files() if self._is_ref(name)}

    def ref_files(self) -> list[str]:
        """Every name below the folder of refs, sorted, also those that are no refs."""
        return sorted(
            path.relative_to(self.ref_folder).as_posix()
            for path in self.ref_folder.rglob("*")
            if path.is_symlink() or not path.is_dir()
        )

    def _is_ref(self, name: str) -> bool:
        path = self.ref_folder / name
        return is_ref(name) and path.is_file() and files.is_inside(path, self.folder)

    def _said(self, path: Path) -> str:
        with path.open("rb") as file:
            return file.read(64).decode(errors="replace")

    def tags(self) -> set[str]:
        """The refs that are tags; the others are branches."""
        return self.tag_marks() & (set(self.refs()) - {MAIN})

    def tag_marks(self) -> set[str]:
        """The names that are marked as tags; a killed creation or deletion leaves one without a ref."""
        found = (path for path in self.tag_folder.rglob("*") if path.is_file())
        return {path.relative_to(self.tag_folder).as_posix() for path in found}

    def revisions(self) -> list[str]:
        """Every revision's id, oldest first."""
        if not self.snapshots.is_dir():
            return []
        ids = [path.name for path in self.snapshots.iterdir() if self.has_revision(path.name)]
        return sorted(ids, key=lambda commit_id: ((self.snapshots / commit_id).stat().st_mtime_ns, commit_id))

    def has_revision(self, commit_id: str) -> bool:
        """Whether the revision's files are here."""
        folder = self.snapshots / commit_id
        return is_commit(commit_id) and folder.is_dir() and not folder.is_symlink()

    def head(self, ref: str) -> str | None:
        """The revision a branch or tag names, or None if it does not exist or is damaged."""
        said = self._said(self.ref_folder / ref) if self._is_ref(checked_ref(ref)) else ""
        return said if self.has_revision(said) else None

    def resolve(self, revision: str) -> str:
        """The commit behind a branch, a tag, a commit id or the first digits of one.

        Raises:
            RefusedError: there is none, or several revisions begin like that.
        """
        commit_id = revision if is_commit(revision) else self.head(revision) or self._abbreviated(revision)
        if commit_id is None or not self.has_revision(commit_id):
            raise revision_not_found(self.name.repo_id, revision, sorted(self.refs()))
        return commit_id

    def _abbreviated(self, revision: str) -> str | None:
        if not is_short_commit(revision) or revision in self.refs():
            return None
        found = [commit_id for commit_id in self.revisions() if commit_id.startswith(revision)]
        if len(found) > 1:
            raise revision_not_found(self.name.repo_id, revision, found)
        return found[0] if found else None

    def commit(self, commit_id: str) -> Commit:
        """The description of a revision; one is made up for revisions that huggingface_hub downloaded."""
        if self.is_described(commit_id):
            return self.description(commit_id)
        shown = [path for path in self.snapshot_files(commit_id) if is_path(path)]
        found = {path: self._derived_entry(commit_id, path) for path in shown}
        return Commit("downloaded", "", "unknown", "1970-01-01T00:00:00+00:00", None, "", found)

    def is_described(self, commit_id: str) -> bool:
        """Whether the revision has a description here, readable or not."""
        return is_commit(commit_id) and os.path.lexists(self._description_file(commit_id))

    def described(self) -> list[str]:
        """The ids of the revisions that have a description here; none where all was downloaded."""
        found = self.commit_folder.glob("*.json") if self.commit_folder.is_dir() else ()
        return sorted(path.stem for path in found if is_commit(path.stem))

    def description(self, commit_id: str) -> Commit:
        """What a push wrote down about a revision.

        Raises:
            RefusedError: there is nothing, or it is damaged.
        """
        path = files.require_inside(self._description_file(commit_id), self.folder)
        if not path.is_file() or path.stat().st_size > MAX_DESCRIPTION:
            raise self.damaged(f"{path} is not the description of a revision")
        try:
            return Commit.from_json(path.read_bytes(), commit_id)
        except RefusedError as refusal:
            raise self.damaged(str(refusal)) from refusal

    def damaged(self, what: str) -> RefusedError:
        """422 with the command that repairs the repository."""
        return RefusedError(f"{what}; repair it with: {self.name.command('repair')}", 422)

    def _description_file(self, commit_id: str) -> Path:
        return self.commit_folder / f"{commit_id}.json"

    def history(self, commit_id: str) -> Iterator[tuple[str, Commit]]:
        """A revision and its ancestors, newest first, as far as they are still here and readable."""
        current, commit = commit_id, self.commit(commit_id)
        yield current, commit
        while commit.parent is not None and self.has_revision(commit.parent):
            current = commit.parent
            try:
                commit = self.commit(current)
            except RefusedError:  # verify names it
                return
            yield current, commit

    def snapshot_files(self, commit_id: str) -> list[str]:
        """The paths that a revision's folder really shows (dangling links included), sorted."""
        folder = self.snapshots / commit_id
        found = []
        for parent, folders, names in os.walk(folder):
            shown = names + [name for name in folders if (Path(parent) / name).is_symlink()]
            found += [(Path(parent) / name).relative_to(folder).as_posix() for name in shown]
        return sorted(found)

    def file(self, commit_id: str, path: str) -> Path:
        """A file that is part of a revision, on disk.

        Raises:
            RefusedError: it is lost, or a symlink leads out of the hub.
        """
        target = files.require_inside(self.snapshots / commit_id / checked_path(path), self.root)
        if not target.is_file():
            raise RefusedError(
                f"the content of {path!r} of {self.name.repo_id!r} is lost: {self.name.command('verify')}",
                422,
            )
        return target

    def blob(self, digest: str) -> Path:
        """Where the content with this SHA-256 is, or would be."""
        return self.blobs / digest

    def has_blob(self, entry: Entry) -> bool:
        """Whether a blob of this name and size is here."""
        path = self.blob(entry.digest)
        return path.is_file() and not path.is_symlink() and path.stat().st_size == entry.size

    def blob_name(self, commit_id: str, path: str) -> str | None:
        """The blob that a revision's file links to, or None where the file is a copy."""
        target = self.snapshots / commit_id / path
        if not target.is_symlink():
            return None
        linked = Path(os.path.normpath(target.parent / target.readlink()))
        return linked.name if linked.parent == self.blobs else None

    def _derived_entry(self, commit_id: str, path: str) -> Entry:
        target, linked = self.snapshots / commit_id / path, self.blob_name(commit_id, path)
        if target.is_file() and files.is_inside(target, self.root):
            return Entry(linked or files.sha256_of(target), target.stat().st_size)
        if linked is None:
            raise self.damaged(f"{target} is not a file")
        return Entry(linked, LOST)
