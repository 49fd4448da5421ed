"""Names from outside (repository ids, revisions, paths, hashes); all access to them goes through here.

Everything that becomes part of a file name passes through here, so nothing else has to think about ``..``,
absolute paths, NUL, or names longer than file systems allow.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, cast, get_args

from huggingface_hub.errors import HFValidationError
from huggingface_hub.utils import validate_repo_id

from lerobot_act_chunking.hub.refusal import RefusedError

Kind = Literal["model", "dataset", "space"]
KINDS: tuple[Kind, ...] = get_args(Kind)

MAX_COMPONENT = 255
"""Longest file name of common file systems [bytes]."""
MAX_NEW_COMPONENT = 240
"""Longest file name that is accepted: huggingface_hub appends up to 13 bytes while it downloads [bytes]."""
MAX_PATH = 1024
"""Longest path inside a repository [bytes]."""

ADDRESS_WORDS = {
    "api", "models", "datasets", "spaces", "kernels", "buckets", "blob", "branch", "commit", "commits",
    "discussions", "info", "lfs", "lfs-batch", "paths-info", "preupload", "raw", "refs", "resolve",
    "revision", "settings", "tag", "tree",
}  # fmt: skip
"""Words of the Hub's addresses: a repository of such a name or owner could not be told from the address."""

_SHORT_COMMIT = re.compile(r"[0-9a-f]{7,39}")
_COMMIT = re.compile(r"[0-9a-f]{40}")
_SHA256 = re.compile(r"[0-9a-f]{64}")
_CONTROL = re.compile(r"[\x00-\x1f\x7f]")
_REVISION_FORBIDDEN = re.compile(r"[\x00-\x20\x7f~^:?*\[\\]|@\{|\.\.")


@dataclass(frozen=True, order=True)
class RepoName:
    """A checked repository name: what kind it is and its id (``name`` or ``org/name``)."""

    kind: Kind
    repo_id: str

    @classmethod
    def checked(cls, kind: object, repo_id: object) -> "RepoName":
        """A name from outside, refused unless it is a kind and an id that the real Hub would accept."""
        if kind not in KINDS:
            raise RefusedError(f"unknown repository kind {shorten(kind)}; choose one of: {', '.join(KINDS)}")
        if not isinstance(repo_id, str) or len(repo_id) > 2 * 96 + 1:
            raise RefusedError(f"{shorten(repo_id)} is not a repository id; use 'name' or 'org/name'")
        try:
            validate_repo_id(repo_id)
        except HFValidationError as error:
            raise RefusedError(str(error)) from error
        return cls(cast("Kind", kind), repo_id)

    def creatable(self) -> "RepoName":
        """The name itself, refused unless huggingface_hub can address a repository of this name."""
        *owner, name = self.repo_id.split("/")
        for part in (*owner, name):
            if part in ADDRESS_WORDS:
                raise RefusedError(
                    f"{part!r} in {self.repo_id!r} is a word of the Hub's addresses, so that could not be "
                    f"loaded; choose another name, none of: {', '.join(sorted(ADDRESS_WORDS))}"
                )
        if owner and owner[0].endswith(".git"):
            raise RefusedError(f"an owner cannot end in '.git': {self.repo_id!r}; choose another name")
        return self

    @classmethod
    def from_folder(cls, folder: str) -> "RepoName | None":
        """The name behind a folder such as ``models--org--name``; None for any other folder."""
        plural, separator, rest = folder.partition("--")
        if not separator or plural.removesuffix("s") not in KINDS:
            return None
        try:
            name = cls.checked(plural.removesuffix("s"), rest.replace("--", "/"))
        except RefusedError:
            return None
        return name if name.folder == folder else None

    @property
    def folder(self) -> str:
        """The folder of huggingface_hub's cache layout."""
        return "--".join([f"{self.kind}s", *self.repo_id.split("/")])

    def command(self, verb: str) -> str:
        """The command of ``act-chunking hub`` that does something with this repository."""
        kind = "" if self.kind == "model" else f" --type {self.kind}"
        return f"act-chunking hub {verb} {self.repo_id}{kind}"

    @property
    def url_path(self) -> str:
        """The repository's path below the hub's address."""
        return self.repo_id if self.kind == "model" else f"{self.kind}s/{self.repo_id}"


def shorten(value: object) -> str:
    """``repr`` for messages, cut so that a hostile name cannot flood the log."""
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


def printable(text: str) -> str:
    """Text for one line of a terminal: control characters and what is no UTF-8 are written as escapes."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def is_commit(revision: str) -> bool:
    """Whether a revision is a full commit id rather than a branch or a tag."""
    return _COMMIT.fullmatch(revision) is not None


def is_short_commit(revision: str) -> bool:
    """Whether a revision may be the beginning of a commit id, as the hub prints it."""
    return _SHORT_COMMIT.fullmatch(revision) is not None


def is_sha256(digest: str) -> bool:
    """Whether a blob name is a SHA-256 digest (the real Hub names small files by git's SHA-1)."""
    return _SHA256.fullmatch(digest) is not None


def is_digest(name: object) -> bool:
    """Whether a name is one that blobs have: a SHA-256, or the SHA-1 of a small file of the real Hub."""
    return isinstance(name, str) and (is_sha256(name) or is_commit(name))


def checked_sha256(digest: object) -> str:
    """A SHA-256 digest from outside [64 lower-case hex digits]."""
    if not isinstance(digest, str) or not is_sha256(digest):
        raise RefusedError(f"{shorten(digest)} is not a SHA-256 digest")
    return digest


def checked_path(path: object) -> str:
    """A file's path inside a repository: relative, no ``.`` or ``..``, no ``.git``, sane lengths."""
    if not isinstance(path, str) or not path or _CONTROL.search(path) or "\\" in path:
        raise RefusedError(f"{shorten(path)} is not a path inside a repository")
    parts = path.split("/")
    if any(part in ("", ".", "..", ".git") for part in parts):
        raise RefusedError(f"{shorten(path)} would leave the repository; use a plain relative path")
    _check_lengths(path, parts)
    return path


def checked_new_path(path: object) -> str:
    """A path that huggingface_hub will also download: no drive (``C:x``), room for its own endings."""
    path = checked_path(path)
    parts = path.split("/")
    if any(part[1:2] == ":" for part in parts):
        raise RefusedError(
            f"{shorten(path)} looks like a Windows drive, which huggingface_hub refuses to load"
        )
    _check_lengths(path, parts, MAX_NEW_COMPONENT)
    return path


def checked_new_ref(name: object) -> str:
    """The name of a branch or tag that huggingface_hub can also load."""
    name = checked_ref(name)
    _check_lengths(name, name.split("/"), MAX_NEW_COMPONENT)
    return name


def checked_ref(name: object) -> str:
    """The name of a branch or tag, by git's rules."""
    if not isinstance(name, str) or not name or _REVISION_FORBIDDEN.search(name):
        raise RefusedError(f"{shorten(name)} is not a branch or tag name")
    parts = name.split("/")
    if any(not part or part.startswith(".") or part.endswith((".lock", ".")) for part in parts):
        raise RefusedError(f"{shorten(name)} is not a branch or tag name")
    if is_commit(name):
        raise RefusedError(f"{name!r} looks like a commit id; a branch or tag needs another name")
    _check_lengths(name, parts)
    return name


def is_path(path: str) -> bool:
    """Whether a path found on disk may be a file of a repository."""
    return _passes(checked_path, path)


def is_ref(name: str) -> bool:
    """Whether a name found on disk may be a branch or a tag."""
    return _passes(checked_ref, name)


def _passes(check: Callable[[object], str], value: str) -> bool:
    try:
        check(value)
    except RefusedError:
        return False
    return True


def _check_lengths(name: str, parts: list[str], limit: int = MAX_COMPONENT) -> None:
    try:
        longest = max(len(part.encode()) for part in parts)
        total = len(name.encode())
    except UnicodeEncodeError as error:
        raise RefusedError(f"{shorten(name)} is not valid UTF-8") from error
    if longest > limit or total > MAX_PATH:
        raise RefusedError(
            f"{shorten(name)} is too long ({total} bytes; at most {MAX_PATH}, {limit} per folder)"
        )
