"""HTTP messages: what a request asks for, checked, and the answers in the real Hub's format."""

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, unquote_to_bytes

import httpx

from lerobot_act_chunking.hub import files
from lerobot_act_chunking.hub.names import RepoName, shorten
from lerobot_act_chunking.hub.refusal import RefusedError
from lerobot_act_chunking.hub.repository import Repository
from lerobot_act_chunking.hub.storage import LocalHub

_RANGE = re.compile(r"bytes=(\d{1,18})-(\d{0,18})")


@dataclass(frozen=True)
class HubRequest:
    """A request that was recognised: its hub, the repository it names if any, what follows in its path."""

    hub: LocalHub
    http: httpx.Request
    name: RepoName | None = None
    rest: list[str] = field(default_factory=list)

    @property
    def repository(self) -> Repository:
        """The repository asked about.

        Raises:
            RefusedError: there is none of that name here.
        """
        return self.hub.open(self.checked_name)

    @property
    def checked_name(self) -> RepoName:
        """The repository's name, which this kind of request always has."""
        if self.name is None:
            raise RefusedError(f"{self.http.url.path} names no repository")
        return self.name

    @property
    def address(self) -> str:
        """The hub's address as the client knows it."""
        return f"{self.http.url.scheme}://{self.http.url.netloc.decode('ascii')}"

    def argument(self, index: int, default: str | None = None) -> str:
        """One element of the path after the action, such as the revision."""
        if index < len(self.rest):
            return self.rest[index]
        if default is None:
            raise RefusedError(f"{self.http.method} {shorten(self.http.url.path)} is incomplete", 404)
        return default

    def path_from(self, index: int) -> str:
        """The file path that starts at an element of the path."""
        return "/".join(self.rest[index:])

    def query(self, key: str) -> str | None:
        """A query parameter, if given."""
        return self.http.url.params.get(key)

    def json(self) -> dict[str, Any]:
        """The body as a JSON object."""
        return json_object(self.http.read())

    def form(self) -> dict[str, list[str]]:
        """The body as an HTML form."""
        try:
            return parse_qs(self.http.read().decode(), strict_parsing=True)
        except ValueError as error:
            raise RefusedError("the body is not a form") from error

    def chunks(self) -> Iterator[bytes]:
        """The body as it streams in."""
        stream = self.http.stream
        if not isinstance(stream, httpx.SyncByteStream):
            raise RefusedError("the local hub serves synchronous clients only")
        return iter(stream)


def path_segments(request: httpx.Request) -> list[str]:
    """The decoded elements of a request's path. ``%2F`` stays inside its element, as in branch names."""
    raw = request.url.raw_path.partition(b"?")[0]
    try:
        return [unquote_to_bytes(part).decode() for part in raw.split(b"/")[1:]]
    except UnicodeDecodeError as error:
        raise RefusedError("the address is not valid UTF-8") from error


def json_object(data: bytes) -> dict[str, Any]:
    """A JSON object from outside."""
    try:
        value = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise RefusedError(f"the body is not JSON: {error}") from error
    if not isinstance(value, dict):
        raise RefusedError("the body is not a JSON object")
    return value


def refused(refusal: RefusedError) -> httpx.Response:
    """The answer that makes huggingface_hub raise its matching exception with our message."""
    message = str(refusal)
    headers = {"X-Error-Message": message.encode("ascii", "replace").decode()[:1000].replace("\n", " ")}
    if refusal.code is not None:
        headers["X-Error-Code"] = refusal.code
    return httpx.Response(refusal.status, headers=headers, json={"error": message})


def file_response(request: httpx.Request, path: Path, headers: dict[str, str]) -> httpx.Response:
    """A file, or the part that ``Range`` asks for; ``HEAD`` gets the headers only."""
    size = path.stat().st_size
    headers = {"Accept-Ranges": "bytes", "Content-Type": "application/octet-stream", **headers}
    wanted = _RANGE.fullmatch(request.headers.get("Range", ""))
    if wanted is None:
        return _stream(request, path, 200, (0, size), headers)
    start, stop = int(wanted[1]), min(int(wanted[2]) + 1 if wanted[2] else size, size)
    if start >= stop:
        return httpx.Response(416, headers={"Content-Range": f"bytes */{size}"})
    return _stream(
        request, path, 206, (start, stop), {"Content-Range": f"bytes {start}-{stop - 1}/{size}", **headers}
    )


def _stream(
    request: httpx.Request, path: Path, status: int, span: tuple[int, int], headers: dict[str, str]
) -> httpx.Response:
    headers = {**headers, "Content-Length": str(span[1] - span[0])}
    if request.method == "HEAD":
        return httpx.Response(status, headers=headers)
    return httpx.Response(status, headers=headers, stream=_FileStream(path, *span))


class _FileStream(httpx.SyncByteStream):
    def __init__(self, path: Path, start: int, stop: int):
        self._path, self._start, self._stop = path, start, stop

    def __iter__(self) -> Iterator[bytes]:
        left = self._stop - self._start
        for chunk in files.read_chunks(self._path, self._start):
            yield chunk[:left]
            left -= len(chunk)
            if left <= 0:
                return
