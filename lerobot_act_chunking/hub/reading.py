"""The requests that look at a repository: what it holds, in the real Hub's JSON, and the files themselves."""

from datetime import UTC, datetime
from pathlib import PurePosixPath
from typing import Any

import httpx

from lerobot_act_chunking.hub.commits import Commit, Entry
from lerobot_act_chunking.hub.http_messages import HubRequest, file_response
from lerobot_act_chunking.hub.names import checked_path, is_sha256
from lerobot_act_chunking.hub.refusal import entry_not_found
from lerobot_act_chunking.hub.repository import MAIN
from lerobot_act_chunking.hub.storage import is_private


def info(request: HubRequest) -> httpx.Response:
    """``model_info``, ``dataset_info``: the newest revision of ``main``, or the one asked for."""
    repository = request.repository
    commit_id = repository.resolve(request.argument(0, MAIN))
    commit = repository.commit(commit_id)
    about = {
        "id": repository.name.repo_id,
        "author": repository.name.repo_id.rpartition("/")[0] or None,
        "sha": commit_id,
        "lastModified": timestamp(commit),
        "private": is_private(repository.folder),
        "gated": False,
        "disabled": False,
        "downloads": 0,
        "likes": 0,
        "tags": [],
        "siblings": [{"rfilename": path, "size": entry.size} for path, entry in sorted(commit.files.items())],
    }
    return httpx.Response(200, json=about)


def refs(request: HubRequest) -> httpx.Response:
    """``list_repo_refs``."""
    repository = request.repository
    tags, listed = repository.tags(), {"branches": [], "tags": [], "converts": [], "pullRequests": []}
    for name in repository.refs():
        commit_id = repository.head(name)
        kind, prefix = ("tags", "refs/tags") if name in tags else ("branches", "refs/heads")
        if commit_id is not None:
            listed[kind].append({"name": name, "ref": f"{prefix}/{name}", "targetCommit": commit_id})
    return httpx.Response(200, json=listed)


def commits(request: HubRequest) -> httpx.Response:
    """``list_repo_commits``: newest first."""
    repository = request.repository
    history = repository.history(repository.resolve(request.argument(0, MAIN)))
    listed = [
        {
            "id": commit_id,
            "title": commit.title,
            "message": commit.description,
            "authors": [{"user": commit.author}],
            "date": timestamp(commit),
        }
        for commit_id, commit in history
    ]
    return httpx.Response(200, json=listed)


def tree(request: HubRequest) -> httpx.Response:
    """``list_repo_tree``, of the whole revision or of one folder."""
    repository = request.repository
    commit = repository.commit(repository.resolve(request.argument(0, MAIN)))
    folder = request.path_from(1)
    prefix = f"{checked_path(folder)}/" if folder else ""
    below = {path: entry for path, entry in commit.files.items() if path.startswith(prefix)}
    if prefix and not below:
        raise entry_not_found(repository.name.repo_id, request.argument(0, MAIN), folder)
    recursive = str(request.query("recursive")).lower() in ("true", "1")
    return httpx.Response(200, json=_listing(below, prefix, recursive))


def paths_info(request: HubRequest) -> httpx.Response:
    """``get_paths_info``: the files and folders that exist among those asked for."""
    repository = request.repository
    commit = repository.commit(repository.resolve(request.argument(0, MAIN)))
    found = []
    for path in request.form().get("paths", []):
        if path in commit.files:
            found.append(_file(path, commit.files[path]))
        elif any(other.startswith(f"{path}/") for other in commit.files):
            found.append(_folder(path))
    return httpx.Response(200, json=found)


def resolve(request: HubRequest) -> httpx.Response:
    """A file's bytes, or with ``HEAD`` what identifies them."""
    repository = request.repository
    revision, path = request.argument(0), request.path_from(1)
    commit_id = repository.resolve(revision)
    entry = repository.commit(commit_id).files.get(path)
    if entry is None:
        raise entry_not_found(repository.name.repo_id, revision, path)
    target = repository.file(commit_id, path)
    return file_response(request.http, target, {"ETag": f'"{entry.digest}"', "X-Repo-Commit": commit_id})


def timestamp(commit: Commit) -> str:
    """When a revision was made, as the Hub writes times."""
    return datetime.fromisoformat(commit.date).astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def _listing(below: dict[str, Entry], prefix: str, recursive: bool) -> list[dict[str, Any]]:
    folders: dict[str, None] = {}
    shown = []
    for path, entry in sorted(below.items()):
        parents = [p.as_posix() for p in reversed(PurePosixPath(path).parents) if p.as_posix() != "."]
        inner = [parent for parent in parents if parent.startswith(prefix)]
        folders.update(dict.fromkeys(inner if recursive else inner[:1]))
        if recursive or not inner:
            shown.append(_file(path, entry))
    return [_folder(path) for path in folders] + shown


def _file(path: str, entry: Entry) -> dict[str, Any]:
    about = {"type": "file", "path": path, "size": entry.size, "oid": entry.digest[:40]}
    if is_sha256(entry.digest):
        about["lfs"] = {"oid": entry.digest, "size": entry.size, "pointerSize": 0}
    return about


def _folder(path: str) -> dict[str, Any]:
    return {"type": "directory", "path": path, "size": 0, "oid": "0" * 40}
