"""Checking a repository against its checksums: what is damaged, what cures it, and what still loads."""

import os
from dataclasses import dataclass, field
from pathlib import Path

from lerobot_act_chunking.hub import files
from lerobot_act_chunking.hub.commits import Commit, Entry
from lerobot_act_chunking.hub.garbage_collection import unreferenced_blobs
from lerobot_act_chunking.hub.names import RepoName, is_commit, is_digest, is_sha256
from lerobot_act_chunking.hub.publishing import leftovers
from lerobot_act_chunking.hub.refusal import RefusedError
from lerobot_act_chunking.hub.repository import MAIN, Repository
from lerobot_act_chunking.hub.storage import LocalHub


@dataclass
class Report:
    """The state of one repository.

    ``problems`` are damage; ``notes`` are not; ``unreferenced`` [bytes] is only space held by pushes under
    way or interrupted.
    """

    repo_id: str
    kind: str
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    intact: list[str] = field(default_factory=list)
    damaged: list[str] = field(default_factory=list)
    names: dict[str, str] = field(default_factory=dict)
    unreferenced: int = 0

    @property
    def loadable(self) -> list[str]:
        """The branches and tags that load, then the revisions that load without having a name."""
        named = sorted(name for name, commit_id in self.names.items() if commit_id in self.intact)
        return named + [commit_id for commit_id in self.intact if commit_id not in self.names.values()]


class Checksums:
    """Compares files with their contents' names; each file is read once, however many revisions show it."""

    def __init__(self, repository: Repository):
        self._root = repository.root
        self._digests: dict[tuple[int, int], str] = {}

    def fault_of(self, path: Path, digest: str | None, size: int | None = None) -> str | None:
        """What is wrong with ``path`` as a content of this digest and size [bytes]; None if nothing is.

        Raises:
            PermissionError: the user may not look.
        """
        try:
            path.lstat()
            if not files.is_inside(path, self._root):
                return "leads out of the hub through a symlink"
            if not path.is_file():
                return "is not a file"
            status = path.stat()
            if size is not None and status.st_size != size:
                return f"has {status.st_size} bytes instead of {size}"
            if digest is not None and self._digest(path, (status.st_dev, status.st_ino), digest) != digest:
                return f"does not match its checksum {digest}"
        except (FileNotFoundError, NotADirectoryError):
            return "is missing"
        except PermissionError:
            raise
        except OSError as error:
            return f"cannot be read ({error.strerror})"
        return None

    def _digest(self, path: Path, key: tuple[int, int], like: str) -> str:
        if key not in self._digests:
            self._digests[key] = files.sha256_of(path) if is_sha256(like) else files.git_sha1_of(path)
        return self._digests[key]


def verify_named(hub: LocalHub, name: RepoName) -> Report:
    """The state of a repository that may be damaged beyond opening."""
    try:
        return verify(hub.open(name))
    except (RefusedError, OSError) as error:
        return Report(name.repo_id, name.kind, [str(error)])


def verify(repository: Repository) -> Report:
    """Read every byte of a repository. Pushes may go on meanwhile.

    Costs one read of each blob, however many revisions show it.
    """
    report = Report(repository.name.repo_id, repository.name.kind)
    report.problems = [_with_cure(repository, f"{path} is not a folder") for path in misplaced(repository)]
    checksums = Checksums(repository)
    for commit_id in repository.revisions():
        problems = _problems_of(repository, commit_id, checksums)
        if not repository.has_revision(commit_id):  # deleted while we looked
            continue
        report.problems += problems
        (report.damaged if problems else report.intact).append(commit_id)
    report.names = repository.refs()
    report.problems += [_with_cure(repository, problem) for problem in _ref_problems(repository)]
    report.notes = _notes(repository)
    report.unreferenced = _unreferenced(repository)
    return report


def _unreferenced(repository: Repository) -> int:
    try:
        waiting = unreferenced_blobs(repository) + leftovers(repository)
    except RefusedError:  # a revision does not say what it shows; that is among the problems
        return 0
    return sum(path.lstat().st_size for path in waiting if path.is_file())


def misplaced(repository: Repository) -> list[Path]:
    """The folders of a repository, and of its revisions, in whose place something else is."""
    found = [part for part in repository.parts if os.path.lexists(part) and not _is_folder(part)]
    if not found and repository.snapshots.is_dir():
        revisions = [path for path in repository.snapshots.iterdir() if is_commit(path.name)]
        found = [path for path in revisions if not _is_folder(path)]
    return sorted(found)


def _is_folder(path: Path) -> bool:
    return path.is_dir() and not path.is_symlink()


def _problems_of(repository: Repository, commit_id: str, checksums: Checksums) -> list[str]:
    if not repository.is_described(commit_id):
        return _undescribed_problems(repository, commit_id, checksums)
    try:
        commit = repository.description(commit_id)
    except RefusedError as refusal:
        return [f"revision {commit_id}: {refusal}"]
    found = []
    for path, entry in commit.files.items():
        try:
            problem = _problem_of(repository, commit_id, path, entry, checksums)
        except PermissionError as error:
            problem = (
                f"revision {commit_id}, file {path}: {error.filename} may not be read; change its permissions"
            )
        found += [] if problem is None else [problem]
    return found + _unexpected(repository, commit_id, commit)


def _problem_of(
    repository: Repository, commit_id: str, path: str, entry: Entry, checksums: Checksums
) -> str | None:
    shown, blob = repository.snapshots / commit_id / path, repository.blob(entry.digest)
    where = f"revision {commit_id}, file {path}"
    lost = checksums.fault_of(blob, entry.digest, entry.size)
    wrong = checksums.fault_of(shown, entry.digest, entry.size)
    if wrong is None and (lost is None or not os.path.lexists(blob)):
        return None
    if lost is None or wrong is None:  # the one restores the other
        bad = f"{blob} {lost}" if lost else f"{shown} {wrong}"
        return _with_cure(repository, f"{where}: {bad}")
    if not os.path.lexists(blob) and repository.blob_name(commit_id, path) == entry.digest:
        return f"{where}: blob {entry.digest} is missing; push that file again"
    return f"{_with_cure(repository, f'{where}: {blob} {lost}')}, then push that file again"


def _undescribed_problems(repository: Repository, commit_id: str, checksums: Checksums) -> list[str]:
    found = []
    for path in repository.snapshot_files(commit_id):
        where = f"revision {commit_id}, file {path}"
        digest, shown = repository.blob_name(commit_id, path), repository.snapshots / commit_id / path
        fault = checksums.fault_of(shown, digest if is_digest(digest) else None)
        if fault is None:
            continue
        blob = None if digest is None else repository.blob(digest)
        if blob is None or not is_digest(digest):
            found.append(_with_cure(repository, f"{where}: {shown} {fault}"))
            continue
        # Content of the real Hub's small files is stored under another name when it is pushed again.
        push = "push that file again"
        if not is_sha256(blob.name):
            push += f", then drop this revision: {repository.name.command('delete')} --revision {commit_id}"
        if os.path.lexists(blob):
            found.append(f"{_with_cure(repository, f'{where}: {blob} {fault}')}, then {push}")
        else:
            found.append(f"{where}: blob {blob.name} is missing; {push}")
    return found


def _unexpected(repository: Repository, commit_id: str, commit: Commit) -> list[str]:
    extra = set(repository.snapshot_files(commit_id)) - set(commit.files)
    return [
        _with_cure(repository, f"revision {commit_id}, file {path}: was added by hand and is not part of it")
        for path in sorted(extra)
    ]


def _ref_problems(repository: Repository) -> list[str]:
    refs = repository.refs()
    found = [
        f"ref {name!r} names {said!r}, which is {_lost(repository, said)}"
        for name, said in refs.items()
        if not repository.has_revision(said)
    ]
    found += [f"{repository.ref_folder / name} is no branch or tag" for name in stray_refs(repository)]
    if lacks_main(repository):
        found.append(f"{repository.ref_folder / MAIN} is missing or a folder")
    return found


def _lost(repository: Repository, commit_id: str) -> str:
    return "a revision whose folder is lost" if repository.is_described(commit_id) else "not a revision"


def lacks_main(repository: Repository) -> bool:
    """Whether ``main`` is lost; a folder of downloads may never have had one."""
    in_the_way = (repository.ref_folder / MAIN).is_dir()
    pushed = os.path.lexists(repository.commit_folder)  # also where all descriptions in it are lost
    return in_the_way or (MAIN not in repository.refs() and pushed)


def stray_refs(repository: Repository) -> list[str]:
    """What lies among the refs and is none."""
    return sorted(set(repository.ref_files()) - set(repository.refs()))


def _notes(repository: Repository) -> list[str]:
    described, revisions = repository.described(), repository.revisions()
    notes = [
        f"revision {commit_id} has no description, so only the files that are there could be checked"
        for commit_id in revisions
        if described and commit_id not in described
    ]
    notes += [
        f"{name!r} was a tag and names nothing: lost, or an interrupted creation or deletion"
        for name in sorted(repository.tag_marks() - set(repository.refs()))
    ]
    lost = [commit_id for commit_id in described if commit_id not in revisions]
    notes += [
        f"revision {commit_id} has a description and no folder: lost, or an interrupted push or deletion; "
        f"{repository.name.command('repair')} builds it again where its files are still here"
        for commit_id in lost
        if commit_id not in repository.refs().values()
    ]
    return notes


def _with_cure(repository: Repository, problem: str) -> str:
    return f"{problem}; repair it with: {repository.name.command('repair')}"
