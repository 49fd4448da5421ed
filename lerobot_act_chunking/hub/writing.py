"""The requests that change a repository, in a push's order: create, pre-upload, upload, commit, tag."""

import base64
import logging
from typing import Any

import httpx

from lerobot_act_chunking.hub import files, publishing
from lerobot_act_chunking.hub.commits import Entry
from lerobot_act_chunking.hub.http_messages import HubRequest, json_object
from lerobot_act_chunking.hub.names import RepoName, checked_new_path, checked_sha256, shorten
from lerobot_act_chunking.hub.refusal import CONFLICT, RefusedError, repo_not_found
from lerobot_act_chunking.hub.repository import MAIN, Repository
from lerobot_act_chunking.hub.storage import set_private

logger = logging.getLogger(__name__)

INLINE_LIMIT = 64 * 1024
"""Files up to this size travel inside the commit, larger ones stream on their own [bytes]."""

EMPTY_GIT_SHA1 = "e69de29bb2d1d6434b8b29ae775ad8c2e48c5391"


def create_repo(request: HubRequest) -> httpx.Response:
    """``create_repo``; the answer carries the full id when the owner was left out."""
    body = request.json()
    name = request.hub.full_name(_named(body))
    answer = {"url": f"{request.address}/{name.url_path}", "name": name.repo_id}
    try:
        request.hub.create(name, private=_private(body) or False)
    except RefusedError as refusal:
        if refusal.status != CONFLICT:
            raise
        # huggingface_hub reads the address from this answer too when called with exist_ok=True.
        return httpx.Response(CONFLICT, json={**answer, "error": str(refusal)})
    logger.info("local hub: created %s in %s", name.repo_id, request.hub.root / name.folder)
    return httpx.Response(200, json=answer)


def delete_repo(request: HubRequest) -> httpx.Response:
    """``delete_repo``."""
    name = request.hub.full_name(_named(request.json()))
    if not request.hub.holds(name):
        raise repo_not_found(name.repo_id, request.hub.root)
    request.hub.delete(name)
    return httpx.Response(200, json={})


def settings(request: HubRequest) -> httpx.Response:
    """``update_repo_settings``: private or public; nothing else means anything for a folder."""
    private = _private(request.json())
    if private is None:
        raise RefusedError("the local hub knows one setting of a repository: private or public")
    set_private(request.repository.folder, private)
    return httpx.Response(200, json={"private": private})


def preupload(request: HubRequest) -> httpx.Response:
    """Which files stream on their own, and what is there already under the same paths."""
    repository = request.repository
    head = repository.head(request.argument(0, MAIN))
    present = repository.commit(head).files if head else {}
    answer = []
    for file in _list(request.json(), "files"):
        path, size = checked_new_path(file.get("path")), _size(file.get("size"))
        inline = size <= INLINE_LIMIT
        oid = _known_oid(repository, present.get(path), inline)
        mode = "regular" if inline else "lfs"
        answer.append({"path": path, "uploadMode": mode, "shouldIgnore": False, "oid": oid})
    return httpx.Response(200, json={"files": answer})


def lfs_batch(request: HubRequest) -> httpx.Response:
    """Where to send each large file; nothing for those whose content is here already."""
    repository = request.repository
    answer: list[dict[str, Any]] = []
    with request.hub.lock(request.checked_name):  # so that no clean-up runs between looking and marking
        for wanted in _list(request.json(), "objects"):
            entry = Entry(checked_sha256(wanted.get("oid")), _size(wanted.get("size")))
            listed: dict[str, Any] = {"oid": entry.digest, "size": entry.size}
            if not publishing.renew_blob(repository, entry):
                target = (
                    f"{request.address}/{repository.name.url_path}.git/lfs/{entry.digest}?size={entry.size}"
                )
                listed["actions"] = {"upload": {"href": target}}
            answer.append(listed)
    return httpx.Response(200, json={"transfer": "basic", "objects": answer})


def lfs_upload(request: HubRequest) -> httpx.Response:
    """One large file's bytes, kept only if length and SHA-256 are those announced."""
    digest, size = checked_sha256(request.argument(0)), _size(request.query("size"))
    publishing.receive_blob(request.repository, request.chunks(), digest, size)
    return httpx.Response(200, json={})


def commit(request: HubRequest) -> httpx.Response:
    """One new revision on a branch, from newline-separated JSON operations."""
    if request.query("create_pr"):
        raise RefusedError("the local hub has no pull requests; push to a branch")
    repository, branch = request.repository, request.argument(0, MAIN)
    change = _change(repository, request.http.read())
    with request.hub.lock(request.checked_name):
        commit_id = publishing.publish_revision(repository, branch, change)
    _say_where(repository, branch, commit_id)
    url = f"{request.address}/{repository.name.url_path}/commit/{commit_id}"
    return httpx.Response(200, json={"success": True, "commitUrl": url, "commitOid": commit_id})


def create_branch(request: HubRequest) -> httpx.Response:
    """``create_branch``."""
    start = request.json().get("startingPoint", MAIN)
    with request.hub.lock(request.checked_name):
        publishing.create_branch(request.repository, request.argument(0), _text(start))
    return httpx.Response(200, json={})


def create_tag(request: HubRequest) -> httpx.Response:
    """``create_tag``."""
    tag = _text(request.json().get("tag"))
    with request.hub.lock(request.checked_name):
        publishing.create_tag(request.repository, tag, request.argument(0, MAIN))
    return httpx.Response(200, json={})


def delete_branch(request: HubRequest) -> httpx.Response:
    """``delete_branch``."""
    with request.hub.lock(request.checked_name):
        publishing.delete_ref(request.repository, request.argument(0), tag=False)
    return httpx.Response(200, json={})


def delete_tag(request: HubRequest) -> httpx.Response:
    """``delete_tag``."""
    with request.hub.lock(request.checked_name):
        publishing.delete_ref(request.repository, request.argument(0), tag=True)
    return httpx.Response(200, json={})


def _change(repository: Repository, body: bytes) -> publishing.Change:
    header: dict[str, Any] = {}
    operations = []
    for line in body.splitlines():
        item = json_object(line)
        value = item.get("value")
        if not isinstance(value, dict):
            raise RefusedError("a line of the commit has no value")
        if item.get("key") == "header":
            header = value
        else:
            operations.append(_operation(repository, item.get("key"), value))
    expected = header.get("parentCommit")
    return publishing.Change(
        title=_text(header.get("summary", "")),
        description=_text(header.get("description", "")),
        operations=operations,
        expected_parent=None if expected is None else repository.resolve(_text(expected)),
    )


def _operation(repository: Repository, key: object, value: dict[str, Any]) -> publishing.Operation:
    path = _text(value.get("path"))
    match key:
        case "file":
            return publishing.add(repository, path, _inline_file(repository, value))
        case "lfsFile":
            return publishing.add(repository, path, _uploaded_file(repository, value))
        case "deletedFile":
            return publishing.delete_file(repository, path)
        case "deletedFolder":
            return publishing.delete_folder(path)
    raise RefusedError(f"the local hub does not know the commit operation {shorten(key)}")


def _inline_file(repository: Repository, value: dict[str, Any]) -> Entry:
    checked_new_path(value.get("path"))  # before anything is stored
    try:
        content = base64.b64decode(_text(value.get("content")), validate=True)
    except ValueError as error:
        raise RefusedError(f"the content of {shorten(value.get('path'))} is not base64") from error
    return publishing.receive_blob(repository, [content])


def _uploaded_file(repository: Repository, value: dict[str, Any]) -> Entry:
    digest = checked_sha256(value.get("oid"))
    if "size" in value:
        return Entry(digest, _size(value["size"]))
    blob = repository.blob(digest)  # a copy of a file of this repository comes without its size
    return Entry(digest, blob.stat().st_size if blob.is_file() else 0)


def _known_oid(repository: Repository, entry: Entry | None, inline: bool) -> str | None:
    """What huggingface_hub compares with to skip unchanged files; None also for a blob that was lost."""
    if entry is None or not repository.has_blob(entry):
        return None
    if not inline or entry.size > INLINE_LIMIT:
        return entry.digest
    return files.git_sha1_of(repository.blob(entry.digest)) if entry.size else EMPTY_GIT_SHA1


def _say_where(repository: Repository, branch: str, commit_id: str) -> None:
    table = repository.commit(commit_id).files
    logger.info(
        "local hub: %s@%s is now %s (%d files, %.1f MB) in %s. "
        "The huggingface.co address that LeRobot prints was not contacted.",
        repository.name.repo_id,
        branch,
        commit_id[:12],
        len(table),
        sum(entry.size for entry in table.values()) / 1e6,
        repository.snapshots / commit_id,
    )


def _named(body: dict[str, Any]) -> RepoName:
    owner, name = body.get("organization"), body.get("name")
    return RepoName.checked(body.get("type") or "model", name if owner is None else f"{owner}/{name}")


def _private(body: dict[str, Any]) -> bool | None:
    # huggingface_hub sends "visibility"; before 1.6 it sent "private".
    if "visibility" in body:
        return body["visibility"] == "private"
    private = body.get("private")
    return private if isinstance(private, bool) else None


def _list(body: dict[str, Any], key: str) -> list[dict[str, Any]]:
    value = body.get(key)
    if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
        raise RefusedError(f"{key!r} is not a list of objects")
    return value


def _size(value: object) -> int:
    if isinstance(value, str) and value.isascii() and value.isdigit() and len(value) < 19:
        return int(value)
    if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1 << 62:
        return value
    raise RefusedError(f"{shorten(value)} is not a size in bytes")


def _text(value: object) -> str:
    if not isinstance(value, str) or any("\ud800" <= character <= "\udfff" for character in value):
        raise RefusedError(f"{shorten(value)} is not text")
    return value
