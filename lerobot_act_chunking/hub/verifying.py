"""Checking a repository against its checksums: what is damaged, and what still loads."""

from dataclasses import dataclass, field

from lerobot_act_chunking.hub import files
from lerobot_act_chunking.hub.collecting import unreferenced_blobs
from lerobot_act_chunking.hub.commits import Commit, Entry
from lerobot_act_chunking.hub.names import is_sha256
from lerobot_act_chunking.hub.publishing import leftovers
from lerobot_act_chunking.hub.refusal import RefusedError
from lerobot_act_chunking.hub.repository import Repository


@dataclass
class Report:
    """The state of one repository.

    ``problems`` are damage; ``unreferenced`` [bytes] is only space held by pushes under way or interrupted.
    """

    repo_id: str
    kind: str
    problems: list[str] = field(default_factory=list)
    intact: list[str] = field(default_factory=list)
    damaged: list[str] = field(default_factory=list)
    names: dict[str, str] = field(default_factory=dict)
    unreferenced: int = 0

    @property
    def loadable(self) -> list[str]:
        """The branches and tags that load, then the revisions that load without having a name."""
        named = sorted(name for name, commit_id in self.names.items() if commit_id in self.intact)
        return named + [commit_id for commit_id in self.intact if commit_id not in self.names.values()]


def verify(repository: Repository) -> Report:
    """Read every byte of a repository. Pushes may go on meanwhile.

    Costs one read of each blob, however many revisions show it.
    """
    report = Report(repository.name.repo_id, repository.name.kind)
    digests: dict[tuple[int, int], str] = {}
    for commit_id in repository.revisions():
        problems = _problems_of(repository, commit_id, digests)
        if not repository.has_revision(commit_id):  # deleted while we looked
            continue
        report.problems += problems
        (report.damaged if problems else report.intact).append(commit_id)
    report.names = repository.refs()
    for name, commit_id in report.names.items():
        if not repository.has_revision(commit_id):
            report.problems.append(
                f"ref {name!r} names {commit_id!r}, which is not a revision: {_mend_ref(repository)}"
            )
    waiting = unreferenced_blobs(repository) + leftovers(repository)
    report.unreferenced = sum(path.lstat().st_size for path in waiting if path.is_file())
    return report


def _problems_of(repository: Repository, commit_id: str, digests: dict[tuple[int, int], str]) -> list[str]:
    try:
        commit = repository.commit(commit_id)
    except RefusedError as refusal:
        return [f"revision {commit_id}: {refusal}"]
    problems = [
        _problem_of(repository, commit_id, path, entry, digests) for path, entry in commit.files.items()
    ]
    return [problem for problem in problems if problem is not None] + _unexpected(
        repository, commit_id, commit
    )


def _problem_of(
    repository: Repository, commit_id: str, path: str, entry: Entry, digests: dict[tuple[int, int], str]
) -> str | None:
    shown = repository.snapshots / commit_id / path
    where = f"revision {commit_id}, file {path}"
    if not shown.is_file():
        return f"{where}: blob {entry.digest} is missing; push that file again"
    if not files.is_inside(shown, repository.root):
        return f"{where}: a symlink leads out of {repository.root}; remove it"
    status = shown.stat()
    if status.st_size != entry.size:
        return f"{where}: {status.st_size} bytes instead of {entry.size}; {_mend(repository, entry)}"
    key = (status.st_dev, status.st_ino)
    if key not in digests:
        digests[key] = files.sha256_of(shown) if is_sha256(entry.digest) else files.git_sha1_of(shown)
    if digests[key] != entry.digest:
        return f"{where}: content does not match its checksum {entry.digest}; {_mend(repository, entry)}"
    return None


def _unexpected(repository: Repository, commit_id: str, commit: Commit) -> list[str]:
    extra = set(repository.snapshot_files(commit_id)) - set(commit.files)
    return [
        f"revision {commit_id}, file {path}: was added by hand and is not part of it"
        for path in sorted(extra)
    ]


def _mend(repository: Repository, entry: Entry) -> str:
    return f"remove {repository.blob(entry.digest)} and push that file again"


def _mend_ref(repository: Repository) -> str:
    newest = next(reversed(repository.revisions()), None)
    return (
        "push again"
        if newest is None
        else f"the newest revision is {newest}; write that id into the ref's file"
    )
