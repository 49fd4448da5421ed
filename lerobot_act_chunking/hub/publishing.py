"""Writing to one repository: blobs, revisions, branches and tags.

Order is what makes a kill harmless: blobs first, then the description and the snapshot (both built aside and
renamed), and the ref last. Callers hold the repository's lock for everything except receiving blobs.
"""

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from lerobot_act_chunking import durable_files
from lerobot_act_chunking.hub import files
from lerobot_act_chunking.hub.commits import Commit, Entry
from lerobot_act_chunking.hub.names import (
    checked_new_path,
    checked_new_ref,
    checked_path,
    checked_ref,
    is_sha256,
)
from lerobot_act_chunking.hub.refusal import RefusedError, conflict, entry_not_found, revision_not_found
from lerobot_act_chunking.hub.repository import MAIN, Repository

ABANDONED = 3600.0
"""Age after which what a push left behind belongs to a push that died [s]."""

Operation = Callable[[dict[str, Entry]], None]
"""One step of a commit: changes the path → entry table in place."""


@dataclass(frozen=True)
class Change:
    """What a push asks for: a message, operations in order, the revision it expects to build on, if any."""

    title: str
    description: str
    operations: list[Operation]
    expected_parent: str | None = None


def receive_blob(
    repository: Repository, chunks: Iterable[bytes], digest: str | None = None, size: int | None = None
) -> Entry:
    """Stream content into the repository, under its SHA-256.

    Raises:
        RefusedError: it is not what ``digest`` and ``size`` [bytes] announced; nothing is kept.
    """
    with files.received(chunks, repository.incoming) as body:
        if size is not None and body.size != size:
            raise RefusedError(f"announced {size} bytes but received {body.size}; nothing was stored")
        if digest is not None and body.digest != digest:
            raise RefusedError(f"announced SHA-256 {digest} but received {body.digest}; nothing was stored")
        durable_files.publish(body.path, repository.blob(body.digest))
        return Entry(body.digest, body.size)


def renew_blob(repository: Repository, entry: Entry) -> bool:
    """Whether the blob is here already, marked as in use by a push under way so that no clean-up takes it.

    A blob of another user in a shared folder cannot be marked; it counts as absent and is sent once more.
    """
    if not repository.has_blob(entry):
        return False
    try:
        os.utime(repository.blob(entry.digest))
    except OSError:
        return False
    return True


def add(repository: Repository, path: str, entry: Entry) -> Operation:
    """Put a blob that has been received at ``path``."""
    path = checked_new_path(path)

    def apply(table: dict[str, Entry]) -> None:
        if not repository.has_blob(entry):
            raise RefusedError(f"the content of {path!r} is not in {repository.blobs} (any more); push again")
        table[path] = entry

    return apply


def delete_file(repository: Repository, path: str) -> Operation:
    """Drop the file at ``path``."""
    path = checked_path(path)

    def apply(table: dict[str, Entry]) -> None:
        if table.pop(path, None) is None:
            raise entry_not_found(repository.name.repo_id, MAIN, path)

    return apply


def delete_folder(path: str) -> Operation:
    """Drop every file below ``path``."""
    prefix = checked_path(path.rstrip("/")) + "/"

    def apply(table: dict[str, Entry]) -> None:
        for gone in [p for p in table if p.startswith(prefix)]:
            del table[gone]

    return apply


def publish_revision(repository: Repository, branch: str, change: Change) -> str:
    """Apply a change on top of a branch's newest revision and move the branch to the result.

    Returns:
        The new revision's id.

    Raises:
        RefusedError: the branch does not exist, is a tag, or moved since ``expected_parent``; or an operation
            is impossible.
    """
    parent = parent_of(repository, branch, change.expected_parent)
    table = dict(repository.commit(parent).files) if parent else {}
    inherited = dict(table)
    for operation in change.operations:
        operation(table)
    if parent is not None and not repository.is_described(parent):
        # Of a download only the blobs' names say what they should be; the new description would believe them.
        _check_contents(repository, {path: e for path, e in table.items() if inherited.get(path) == e})
    _check_folders(table)
    commit = Commit.now(title=change.title, description=change.description, parent=parent, files=table)
    write_snapshot(repository, commit, parent)
    point(repository, branch, commit.commit_id)
    files.remove_abandoned(repository.incoming, ABANDONED)
    return commit.commit_id


def create_branch(repository: Repository, branch: str, revision: str) -> None:
    """A branch that starts at ``revision``."""
    _new_name(repository, branch)
    commit_id = repository.resolve(revision)
    durable_files.remove(repository.tag_folder / branch)  # of a tag whose creation or deletion was killed
    point(repository, branch, commit_id)


def create_tag(repository: Repository, tag: str, revision: str) -> None:
    """A name for ``revision`` that pushes do not move."""
    _new_name(repository, tag)
    commit_id = repository.resolve(revision)
    # The mark goes first: a tag whose creation is killed is no ref at all rather than a branch.
    durable_files.write_atomically(repository.tag_folder / tag, b"", repository.incoming)
    point(repository, tag, commit_id)


def delete_ref(repository: Repository, ref: str, *, tag: bool) -> None:
    """Forget a tag or a branch; the revision itself stays."""
    path = files.require_inside(repository.ref_folder / checked_ref(ref), repository.folder)
    if not path.is_file() or tag != (ref in repository.tags()):
        raise revision_not_found(repository.name.repo_id, ref, sorted(repository.refs()))
    if ref == MAIN:
        raise RefusedError(f"branch {MAIN!r} cannot be deleted; delete the repository instead", 403)
    path.unlink()
    durable_files.remove(repository.tag_folder / ref)
    durable_files.sync_folder(path.parent)
    for folder in (repository.ref_folder, repository.tag_folder):
        files.remove_empty_parents(folder / ref, folder)  # "a" may be a name again when "a/b" is gone


def parent_of(repository: Repository, branch: str, expected: str | None = None) -> str | None:
    """The revision that a push to ``branch`` builds on; None for the first one of a folder without any.

    Its description is enough: the push brings or finds every content, and its own folder is complete.

    Raises:
        RefusedError: the branch does not exist, is a tag, is damaged, or is not at ``expected``.
    """
    refs, name = repository.refs(), repository.name
    if branch in repository.tags():
        raise RefusedError(f"{branch!r} is a tag of {name.repo_id!r}; push to a branch")
    if branch not in refs and branch != MAIN:
        raise revision_not_found(name.repo_id, branch, sorted(refs))
    parent = refs.get(branch)
    if parent is None and not repository.described():
        return None
    if parent is None or not (repository.has_revision(parent) or repository.is_described(parent)):
        raise repository.damaged(f"branch {branch!r} of {name.repo_id!r} names no revision")
    if expected is not None and expected != parent:
        raise RefusedError(
            f"{branch!r} is at {parent}, not at {expected}: somebody pushed in between; load it first", 412
        )
    return parent


def _check_folders(table: dict[str, Entry]) -> None:
    folders = {parent.as_posix() for path in table for parent in PurePosixPath(path).parents}
    for path in table:
        if path in folders:
            raise RefusedError(
                f"{path!r} cannot be a file and a folder at once; delete the one or rename the other"
            )


def _new_name(repository: Repository, ref: str) -> None:
    checked_new_ref(ref)
    refs = repository.refs()
    if ref in refs:
        kind = "tag" if ref in repository.tags() else "branch"
        raise conflict(f"{repository.name.repo_id!r} already has a {kind} {ref!r}")
    if any(other.startswith(f"{ref}/") or ref.startswith(f"{other}/") for other in refs):
        raise RefusedError(
            f"{ref!r} clashes with another branch or tag that is a folder of it, or the other way round"
        )


def point(repository: Repository, ref: str, commit_id: str) -> None:
    """Make a branch or tag name a revision."""
    path = files.require_inside(repository.ref_folder / ref, repository.folder)
    durable_files.write_atomically(path, commit_id.encode(), repository.incoming)


def write_snapshot(repository: Repository, commit: Commit, parent: str | None) -> None:
    """Give a revision its description and its folder."""
    commit_id = commit.commit_id
    with durable_files.scratch_path(repository.incoming) as tree:
        tree.mkdir()
        for path, entry in commit.files.items():
            _place_file(repository, tree / path, entry, repository.snapshots / str(parent) / path)
        for folder, _, _ in tree.walk():
            durable_files.sync_folder(folder)
        description = repository.commit_folder / f"{commit_id}.json"
        durable_files.write_atomically(description, commit.to_json(), repository.incoming)
        durable_files.publish(tree, repository.snapshots / commit_id)


def _place_file(repository: Repository, target: Path, entry: Entry, previous: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    blob = repository.blob(entry.digest)
    if is_sha256(entry.digest) and not blob.exists() and previous.is_file():
        # A downloaded revision without symlinks holds its only copy in the snapshot itself.
        receive_blob(repository, files.read_chunks(previous), entry.digest, entry.size)
    if not repository.has_blob(entry):
        raise _lost(repository, "/".join(target.relative_to(repository.incoming).parts[1:]))
    files.place(blob, target, link_from(repository.incoming, target, entry))


def _check_contents(repository: Repository, table: dict[str, Entry]) -> None:
    for path, entry in table.items():
        blob = repository.blob(entry.digest)
        if blob.is_file():
            digest_of = files.sha256_of if is_sha256(entry.digest) else files.git_sha1_of
            if digest_of(blob) != entry.digest:
                raise _lost(repository, path)


def _lost(repository: Repository, path: str) -> RefusedError:
    return RefusedError(
        f"the content of {path!r} in {repository.name.repo_id!r} is lost or damaged; push that file too, "
        "or delete it in the same push",
        422,
    )


def link_from(folder: Path, target: Path, entry: Entry) -> str:
    """The relative symlink to a blob for ``target``, a file of a revision that lies in ``folder``."""
    return "../" * len(target.relative_to(folder).parts) + f"blobs/{entry.digest}"


def leftovers(repository: Repository) -> list[Path]:
    """Bodies that are being received, or that killed pushes left half received."""
    return sorted(repository.incoming.iterdir()) if repository.incoming.is_dir() else []
