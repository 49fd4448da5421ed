"""An HTTP transport that answers huggingface_hub from a folder, inside the process, without a socket."""

import re
from collections.abc import Callable
from typing import Any
from urllib.parse import urlsplit

import httpx
import yaml
from huggingface_hub import constants
from huggingface_hub.errors import OfflineModeIsEnabled

from lerobot_act_chunking import durable_files
from lerobot_act_chunking.hub import reading, writing
from lerobot_act_chunking.hub.commits import current_user
from lerobot_act_chunking.hub.http_messages import HubRequest, path_segments, refused
from lerobot_act_chunking.hub.names import KINDS, RepoName, shorten
from lerobot_act_chunking.hub.refusal import RefusedError
from lerobot_act_chunking.hub.storage import LocalHub

Handler = Callable[[HubRequest], httpx.Response]

HUB_HOST = "huggingface.co"
"""Where huggingface_hub validates model cards, whatever HF_ENDPOINT says."""

REPOSITORY_ROUTES: dict[tuple[str, str], Handler] = {
    ("GET", ""): reading.info,
    ("GET", "revision"): reading.info,
    ("GET", "refs"): reading.refs,
    ("GET", "commits"): reading.commits,
    ("GET", "tree"): reading.tree,
    ("POST", "paths-info"): reading.paths_info,
    ("GET", "resolve"): reading.resolve,
    ("HEAD", "resolve"): reading.resolve,
    ("PUT", "settings"): writing.settings,
    ("POST", "preupload"): writing.preupload,
    ("POST", "commit"): writing.commit,
    ("POST", "branch"): writing.create_branch,
    ("DELETE", "branch"): writing.delete_branch,
    ("POST", "tag"): writing.create_tag,
    ("DELETE", "tag"): writing.delete_tag,
    ("POST", "lfs-batch"): writing.lfs_batch,
    ("PUT", "lfs"): writing.lfs_upload,
}
READS = {("POST", "paths-info")} | {route for route in REPOSITORY_ROUTES if route[0] in ("GET", "HEAD")}
_LFS_BATCH = ["info", "lfs", "objects", "batch"]
ACTIONS = {action for _, action in REPOSITORY_ROUTES}


class LocalHubTransport(httpx.BaseTransport):
    """Answers every request to the Hub from ``hub``; other hosts are reached through ``outside``.

    With ``fall_through``, reads of repositories that the folder lacks also go ``outside``; writes never do.
    """

    def __init__(
        self, hub: LocalHub, *, fall_through: bool = False, outside: httpx.BaseTransport | None = None
    ):
        self.hub = hub
        self.fall_through = fall_through
        self._outside = outside
        self._hosts = {HUB_HOST, urlsplit(constants.ENDPOINT).hostname}

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        """Answer one request; refusals become HTTP errors that huggingface_hub turns into its exceptions."""
        if request.url.host not in self._hosts:
            return self._ask_outside(request)
        try:
            return self._answer(request)
        except RefusedError as refusal:
            return refused(refusal)
        except OSError as error:
            return refused(_disk_refusal(error, self.hub))

    def close(self) -> None:
        """Close the connection to the outside, if one was opened."""
        if self._outside is not None:
            self._outside.close()

    def _answer(self, request: httpx.Request) -> httpx.Response:
        segments = path_segments(request)
        handler = _GLOBAL_ROUTES.get((request.method, "/".join(segments)))
        if handler is not None:
            return handler(HubRequest(self.hub, request))
        readings = _readings(segments)
        if not readings:
            if self.fall_through and request.method in ("GET", "HEAD"):
                return self._ask_outside(request)
            raise _unsupported(request)
        held = [reading for reading in readings if self.hub.holds(self.hub.full_name(reading[1]))]
        action, name, rest = (held or readings)[0]
        hub_request = HubRequest(self.hub, request, self.hub.full_name(name), rest)
        route = (request.method, action)
        if self.fall_through and route in READS and not self.hub.holds(hub_request.checked_name):
            return self._ask_outside(request)
        if not action and request.method not in ("GET", "HEAD"):
            raise _without_action(request)
        if route not in REPOSITORY_ROUTES:
            raise _unsupported(request)
        return REPOSITORY_ROUTES[route](hub_request)

    def _ask_outside(self, request: httpx.Request) -> httpx.Response:
        if constants.HF_HUB_OFFLINE:
            raise OfflineModeIsEnabled(
                f"Cannot reach {request.url}: HF_HUB_OFFLINE is set. Unset it to go online."
            )
        if self._outside is None:
            self._outside = _Outside()
        return self._outside.handle_request(request)


class _Outside(httpx.BaseTransport):
    """The network as httpx reaches it by default: proxies and certificates from the environment."""

    def __init__(self):
        self._client = httpx.Client(timeout=None)  # noqa: S113  (each request carries its own)

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        return self._client.send(request, stream=True, follow_redirects=False)

    def close(self) -> None:
        self._client.close()


def _readings(segments: list[str]) -> list[tuple[str, RepoName, list[str]]]:
    """(action, repository, what follows) in every way to read an address; nothing if it names none.

    ``act/resolve/tree/x`` is a file of the user's ``act`` at the branch ``tree``, or in the tree of
    ``act/resolve``.
    """
    if segments[:1] == ["api"]:
        kind = segments[1].removesuffix("s") if len(segments) > 2 else ""
        return _split(kind, segments[2:]) if kind in KINDS and segments[1] != kind else []
    kind = segments[0].removesuffix("s")
    if kind in KINDS and segments[0] != kind:
        return _split(kind, segments[1:])
    return _split("model", segments)


def _split(kind: str, segments: list[str]) -> list[tuple[str, RepoName, list[str]]]:
    readings = []
    for length in _name_lengths(segments):
        repo_id, after = "/".join(segments[:length]), segments[length:]
        if repo_id.endswith(".git"):
            repo_id, after = repo_id.removesuffix(".git"), ["lfs-batch"] if after == _LFS_BATCH else after
        readings.append((after[0] if after else "", RepoName.checked(kind, repo_id), after[1:]))
    return readings


def _name_lengths(segments: list[str]) -> list[int]:
    """How many leading elements may be the repository's id: those before ``.git`` or a known action."""
    for length in (1, 2):
        if len(segments) >= length and segments[length - 1].endswith(".git"):
            return [length]
    return [
        length
        for length in (2, 1)
        if len(segments) == length or (len(segments) > length and segments[length] in ACTIONS)
    ]


def _whoami(request: HubRequest) -> httpx.Response:
    user = current_user()
    return httpx.Response(200, json={"type": "user", "id": user, "name": user, "fullname": user, "orgs": []})


def _validate_card(request: HubRequest) -> httpx.Response:
    """The front matter of a README must be a YAML mapping; the real Hub's further rules need the real Hub."""
    content = request.json().get("content")
    block = re.match(
        r"\s*---[ \t]*\r?\n(.*?)\r?\n---", content if isinstance(content, str) else "", re.DOTALL
    )
    errors: list[dict[str, Any]] = []
    try:
        if block is not None and not isinstance(yaml.safe_load(block[1]), dict | None):
            errors.append({"message": "the metadata at the top of README.md is not a mapping"})
    except yaml.YAMLError as error:
        errors.append({"message": f"the metadata at the top of README.md is not YAML: {error}"})
    return httpx.Response(400 if errors else 200, json={"errors": errors, "warnings": []})


_GLOBAL_ROUTES: dict[tuple[str, str], Handler] = {
    ("POST", "api/repos/create"): writing.create_repo,
    ("DELETE", "api/repos/delete"): writing.delete_repo,
    ("POST", "api/validate-yaml"): _validate_card,
    ("GET", "api/whoami-v2"): _whoami,
}


def _unsupported(request: httpx.Request) -> RefusedError:
    return RefusedError(f"the local hub has no answer to {request.method} {shorten(request.url.path)}", 404)


def _without_action(request: httpx.Request) -> RefusedError:
    """The client removed a branch ``..`` from its address, and the action before it."""
    where = f"{request.method} {shorten(request.url.path)}"
    return RefusedError(f"{where} names a repository and no more; no branch can be called '..'", 400)


def _disk_refusal(error: OSError, hub: LocalHub) -> RefusedError:
    if error.errno in durable_files.DISK_FULL:
        return RefusedError(
            f"no space left for the local hub {hub.root}; nothing was published, earlier revisions are safe. "
            "Free some space (act-chunking hub delete) and push again",
            507,
        )
    if isinstance(error, PermissionError):
        return RefusedError(f"the local hub {hub.root} does not let you do that: {error}", 403)
    if isinstance(error, FileNotFoundError):
        return RefusedError(f"the local hub {hub.root} changed underneath (deleted meanwhile?): {error}", 410)
    if isinstance(error, ConnectionError):  # the outside, not the disk
        raise error
    return RefusedError(f"the local hub {hub.root} is damaged: {error}; see: act-chunking hub verify", 422)
