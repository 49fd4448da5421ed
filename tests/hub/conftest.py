"""A local hub in a temporary folder, huggingface_hub routed to it, and no network at all."""

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
from huggingface_hub import HfApi, constants, set_client_factory
from huggingface_hub.utils._http import default_client_factory

from lerobot_act_chunking.hub import routing
from lerobot_act_chunking.hub.storage import LocalHub

# huggingface_hub hands files to httpx in a way httpx deprecates; it happens to everybody who uploads.
HTTPX_UPLOAD = "ignore:Use 'content=:DeprecationWarning"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.filterwarnings(HTTPX_UPLOAD))


@pytest.fixture(autouse=True)
def no_network(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """Every attempt to connect fails; downloads, tokens and settings live in this test's folder."""

    def refuse(self: socket.socket, address: object) -> None:
        raise AssertionError(f"a socket was opened to {address}")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "downloads"))
    monkeypatch.setattr(constants, "HF_TOKEN_PATH", str(tmp_path / "token"))
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False)  # sockets are refused, and some tests open one
    monkeypatch.setattr(constants, "HF_HUB_DISABLE_XET", True)
    monkeypatch.setattr(constants, "HF_HUB_DISABLE_TELEMETRY", True)
    monkeypatch.setenv("HF_HUB_DISABLE_XET", "1")
    monkeypatch.setenv("HF_HUB_DISABLE_PROGRESS_BARS", "1")
    for variable in ("HF_TOKEN", "HUGGING_FACE_HUB_TOKEN", routing.LOCAL_HUB, routing.FALL_THROUGH):
        monkeypatch.delenv(variable, raising=False)
    yield
    set_client_factory(default_client_factory)


@pytest.fixture
def hub(tmp_path: Path) -> LocalHub:
    """An empty hub that huggingface_hub is routed to."""
    hub = LocalHub(tmp_path / "hub")
    routing.route_to(hub)
    return hub


@pytest.fixture
def api(hub: LocalHub) -> HfApi:
    return HfApi()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A small checkpoint: text, weights above and below the inline limit, a subfolder, an empty file."""
    source = tmp_path / "source"
    (source / "sub").mkdir(parents=True)
    (source / "README.md").write_text("---\nlicense: mit\n---\n# A card\n")
    (source / "config.json").write_text('{"type": "act"}')
    (source / "model.safetensors").write_bytes(os.urandom(300_000))
    (source / "sub" / "state.safetensors").write_bytes(os.urandom(5_000))
    (source / "sub" / "empty.txt").touch()
    return source
