"""A revision's description: which file is which blob, and where the revision came from."""

import getpass
import hashlib
import json
import uuid
from dataclasses import asdict, dataclass
from datetime import UTC, datetime

from lerobot_act_chunking.hub.names import checked_path, is_commit, is_digest, printable, shorten
from lerobot_act_chunking.hub.refusal import RefusedError


@dataclass(frozen=True)
class Entry:
    """One file of a revision: its blob's name (SHA-256, hex) and its size [bytes]."""

    digest: str
    size: int

    def checked(self) -> "Entry":
        """The entry itself, refused unless it can only mean a blob of its own repository."""
        if not is_digest(self.digest) or not isinstance(self.size, int):
            raise RefusedError(f"{shorten(self.digest)} is not the name of a blob")
        return self


@dataclass(frozen=True)
class Commit:
    """One revision. Its id is the SHA-1 of its own description, so a damaged description betrays itself."""

    title: str
    description: str
    author: str
    date: str
    parent: str | None
    nonce: str
    files: dict[str, Entry]

    @classmethod
    def now(cls, *, title: str, description: str, parent: str | None, files: dict[str, Entry]) -> "Commit":
        """A new revision made by the current user at this moment."""
        return cls(
            title=title,
            description=description,
            author=current_user(),
            date=datetime.now(UTC).isoformat(),
            parent=parent,
            nonce=uuid.uuid4().hex,
            files=files,
        )

    def to_json(self) -> bytes:
        """The canonical bytes that the id is computed from."""
        return json.dumps(asdict(self), sort_keys=True, separators=(",", ":")).encode()

    @property
    def commit_id(self) -> str:
        """The revision's id [40 hex digits], as git would shape it."""
        return hashlib.sha1(self.to_json(), usedforsecurity=False).hexdigest()

    @classmethod
    def from_json(cls, data: bytes, commit_id: str) -> "Commit":
        """Read a description back.

        Raises:
            RefusedError: it is not the description of ``commit_id`` (damaged on disk).
        """
        try:
            fields = json.loads(data)
            datetime.fromisoformat(fields["date"]).astimezone(UTC)
            for key in ("title", "description", "author"):
                fields[key].encode()
            fields["files"] = {
                checked_path(path): Entry(**entry).checked() for path, entry in fields["files"].items()
            }
            commit = cls(**fields)
        except (RefusedError, ValueError, TypeError, LookupError, AttributeError) as error:
            raise _damaged(commit_id, str(error)) from error
        except (RecursionError, OverflowError, MemoryError) as error:
            raise _damaged(commit_id, type(error).__name__) from error
        if not is_commit(commit_id) or commit.commit_id != commit_id:
            raise _damaged(commit_id, "its checksum differs")
        return commit


def _damaged(commit_id: str, reason: str) -> RefusedError:
    return RefusedError(f"the description of revision {commit_id} is damaged: {printable(reason[:200])}", 422)


def current_user() -> str:
    """The login name, or a stand-in where the system has none (a container with a bare user number)."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return "unknown"
