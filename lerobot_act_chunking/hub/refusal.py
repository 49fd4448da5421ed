"""How the local hub says no: an error that is also an HTTP answer huggingface_hub understands."""

from lerobot_act_chunking.errors import ActChunkingError

CONFLICT = 409


class RefusedError(ActChunkingError):
    """A request that the hub turns down.

    ``status`` and ``code`` are the real Hub's, because huggingface_hub picks its exception class by them
    (``RepoNotFound`` becomes ``RepositoryNotFoundError`` and so on).
    """

    def __init__(self, message: str, status: int = 400, code: str | None = None):
        super().__init__(message)
        self.status = status
        self.code = code


def repo_not_found(repo_id: str, where: object) -> RefusedError:
    """404 for a repository that the folder ``where`` does not hold."""
    return RefusedError(f"{repo_id!r} is not in the local hub {where}", 404, "RepoNotFound")


def revision_not_found(repo_id: str, revision: str, known: list[str]) -> RefusedError:
    """404 for a branch, tag or commit that the repository does not have."""
    names = ", ".join(known) or "none"
    return RefusedError(
        f"{repo_id!r} has no revision {revision!r}; branches and tags: {names}", 404, "RevisionNotFound"
    )


def entry_not_found(repo_id: str, revision: str, path: str) -> RefusedError:
    """404 for a file that the revision does not contain."""
    return RefusedError(f"{repo_id!r} has no file {path!r} at revision {revision!r}", 404, "EntryNotFound")


def conflict(message: str) -> RefusedError:
    """409: the name is taken. huggingface_hub turns it into success when called with ``exist_ok=True``."""
    return RefusedError(message, CONFLICT)
