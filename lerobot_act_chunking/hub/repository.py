"""Reading one repository folder: its refs, revisions and files. Writing lives in ``publishing``."""

import os
from collections.abc import Iterator
from pathlib import Path

from lerobot_act_chunking.hub import files
from lerobot_act_chunking.hub.commits import Commit, Entry
from lerobot_act_chunking.hub.names import RepoName, checked_path, checked_ref, is_commit
from lerobot_act_chunking.hub.refusal import RefusedError, entry_not_found, revision_not_found

MAIN = "main"
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
        for part in (
            self.blobs,
            self.snapshots,
            self.ref_folder,
            self.tag_folder,
            self.commit_folder,
            self.incoming,
        ):
            files.require_inside(part, self.folder)

    @staticmethod
    def initialise(folder: Path) -> None:
        """Lay out an empty repository: every folder, and one revision without files on ``main``."""
        for part in ("blobs", "refs", "snapshots", f"{_OUR_FOLDER}/tags", f"{_OUR_FOLDER}/incoming"):
            (folder / part).mkdir(parents=True)
        first = Commit.now(title="initial commit", description="", parent=None, files={})
        scratch = folder / _OUR_FOLDER / "incoming"
        files.write_durably(
            folder / _OUR_FOLDER / "commits" / f"{first.commit_id}.json", first.to_json(), scratch
        )
        (folder / "snapshots" / first.commit_id).mkdir()
        files.write_durably(folder / "refs" / MAIN, first.commit_id.encode(), scratch)

    def refs(self) -> dict[str, str]:
        """What every branch and tag says, by name; a damaged ref says something that is no revision."""
        found = {}
        for path in sorted(self.ref_folder.rglob("*")):
            if path.is_file() and files.is_inside(path, self.folder):
                with path.open("rb") as file:
                    found[path.relative_to(self.ref_folder).as_posix()] = file.read(64).decode(
                        errors="replace"
                    )
        return found

    def tags(self) -> set[str]:
        """The refs that are tags; the others are branches."""
        return {name for name in self.refs() if (self.tag_folder / name).is_file()}

    def revisions(self) -> list[str]:
        """Every revision's id, oldest first."""
        if not self.snapshots.is_dir():
            return []
        ids = [path.name for path in self.snapshots.iterdir() if is_commit(path.name) and path.is_dir()]
        return sorted(ids, key=lambda commit_id: ((self.snapshots / commit_id).stat().st_mtime_ns, commit_id))

    def has_revision(self, commit_id: str) -> bool:
        """Whether the revision's files are here."""
        return is_commit(commit_id) and (self.snapshots / commit_id).is_dir()

    def head(self, ref: str) -> str | None:
        """The revision a branch or tag names, or None if it does not exist or is damaged."""
        path = self.ref_folder / checked_ref(ref)
        if not path.is_file() or not files.is_inside(path, self.folder):
            return None
        with path.open("rb") as file:
            commit_id = file.read(64).decode(errors="replace")
        return commit_id if self.has_revision(commit_id) else None

    def resolve(self, revision: str) -> str:
        """The commit behind a branch, a tag or a full commit id.

        Raises:
            RefusedError: there is none.
        """
        commit_id = revision if is_commit(revision) else self.head(revision)
        if commit_id is None or not self.has_revision(commit_id):
            raise revision_not_found(self.name.repo_id, revision, sorted(self.refs()))
        return commit_id

    def commit(self, commit_id: str) -> Commit:
        """The description of a revision; one is made up for revisions that huggingface_hub downloaded."""
        path = self.commit_folder / f"{commit_id}.json"
        if path.is_file():
            return Commit.from_json(path.read_bytes(), commit_id)
        found = {path: self._derived_entry(commit_id, path) for path in self.snapshot_files(commit_id)}
        return Commit("downloaded", "", "unknown", "1970-01-01T00:00:00+00:00", None, "", found)

    def history(self, commit_id: str) -> Iterator[tuple[str, Commit]]:
        """A revision and its ancestors, newest first, as far as they are still here."""
        current: str | None = commit_id
        while current is not None and self.has_revision(current):
            commit = self.commit(current)
            yield current, commit
            current = commit.parent

    def snapshot_files(self, commit_id: str) -> list[str]:
        """The paths that a revision's folder really shows (dangling links included), sorted."""
        folder = self.snapshots / commit_id
        found = []
        for parent, _, names in os.walk(folder):
            found += [(Path(parent) / name).relative_to(folder).as_posix() for name in names]
        return sorted(found)

    def file(self, commit_id: str, path: str) -> Path:
        """The file of a revision on disk.

        Raises:
            RefusedError: the revision has no such file, or a symlink leads out of the hub.
        """
        target = self.snapshots / commit_id / checked_path(path)
        if not target.is_file():
            raise entry_not_found(self.name.repo_id, commit_id, path)
        return files.require_inside(target, self.root)

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
        target = self.snapshots / commit_id / path
        if not target.is_file():
            raise RefusedError(f"{target} is a broken link", 422)
        files.require_inside(target, self.root)
        return Entry(self.blob_name(commit_id, path) or files.sha256_of(target), target.stat().st_size)
