"""What the environment switches on, and what a run that would push finds out at its start."""

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest
from huggingface_hub import HfApi, constants, get_session, set_client_factory

from lerobot_act_chunking import hub as hub_package
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.hub import preflight, routing
from lerobot_act_chunking.hub.names import RepoName
from lerobot_act_chunking.hub.preflight import check_push
from lerobot_act_chunking.hub.storage import LocalHub
from lerobot_act_chunking.hub.transport import LocalHubTransport


def transport() -> object:
    return get_session()._transport


def test_without_the_variable_nothing_changes():
    before = type(transport())
    hub_package.install()
    assert type(transport()) is before is not LocalHubTransport


@pytest.mark.parametrize("fall_through", ["", "0", "1"])
def test_the_variables_route_requests_to_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fall_through: str
):
    monkeypatch.setenv(routing.LOCAL_HUB, str(tmp_path / "hub"))
    monkeypatch.setenv(routing.FALL_THROUGH, fall_through)
    monkeypatch.setattr(constants, "HF_HUB_DISABLE_XET", False)
    hub_package.install()
    hub_package.install()
    used = transport()
    assert isinstance(used, LocalHubTransport)
    assert used.hub.root == tmp_path / "hub"
    assert used.fall_through == (fall_through == "1")
    assert constants.HF_HUB_DISABLE_XET is True
    assert os.environ["HF_HUB_DISABLE_XET"] == "1"
    HfApi().create_repo("me/act")
    assert (tmp_path / "hub" / "models--me--act").is_dir()


def test_a_proxy_does_not_come_between(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for variable in ("HTTPS_PROXY", "ALL_PROXY"):
        monkeypatch.setenv(variable, "http://proxy.example:3128")
    routing.route_to(LocalHub(tmp_path / "hub"))
    HfApi().create_repo("me/act")
    assert (tmp_path / "hub" / "models--me--act").is_dir()


def test_another_endpoint_is_served_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(constants, "ENDPOINT", "https://mirror.example")
    routing.route_to(LocalHub(tmp_path / "hub"))
    api = HfApi(endpoint="https://mirror.example")
    assert api.create_repo("me/act") == "https://mirror.example/me/act"
    content = os.urandom(70_000)
    pushed = api.upload_file(path_or_fileobj=content, path_in_repo="a", repo_id="me/act")
    assert pushed.oid == api.model_info("me/act").sha


@pytest.mark.parametrize("variable", ["HF_HUB_CACHE", "HF_LEROBOT_HOME"])
def test_the_hub_must_not_be_a_download_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variable: str):
    folder = tmp_path / "hub"
    if variable == "HF_HUB_CACHE":
        monkeypatch.setattr(constants, "HF_HUB_CACHE", str(folder))
    else:
        monkeypatch.setenv(variable, str(tmp_path))
    routing.route_to(LocalHub(folder))
    with pytest.raises(ConfigurationError, match=f"{variable} name the same folder"):
        HfApi().create_repo("me/act")


def test_child_processes_inherit_the_hub(tmp_path: Path):
    code = "from lerobot_act_chunking import hub; hub.install(); "
    code += "from huggingface_hub import HfApi; print(HfApi().create_repo('me/act').repo_id)"
    environment = {**os.environ, routing.LOCAL_HUB: str(tmp_path / "hub")}
    command = [sys.executable, "-W", "ignore", "-c", code]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "me/act"
    assert LocalHub(tmp_path / "hub").names() == [RepoName("model", "me/act")]


@dataclass
class Settings:
    push_to_hub: bool = True
    repo_id: str | None = "me/act"


def without_ways_out(message: str) -> str:
    for way in (routing.LOCAL_HUB, "hf auth login", "--policy.push_to_hub=false"):
        assert way in message
    return message.split("Three ways out")[0]


def test_a_run_that_does_not_push_needs_nothing():
    check_push(Settings(push_to_hub=False, repo_id=None))


def test_the_default_of_pushing_without_a_name_fails_at_the_start():
    with pytest.raises(ConfigurationError) as failure:
        check_push(Settings(repo_id=None))
    assert "--policy.push_to_hub is on by default" in without_ways_out(str(failure.value))


def test_a_missing_name_alone_is_left_to_lerobot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv(routing.LOCAL_HUB, str(tmp_path / "hub"))
    check_push(Settings(repo_id=None))
    assert not (tmp_path / "hub").exists()


def test_a_push_without_a_login_fails_at_the_start():
    with pytest.raises(ConfigurationError) as failure:
        check_push(Settings())
    assert "nobody is logged in" in without_ways_out(str(failure.value))


def test_a_push_in_offline_mode_fails_at_the_start(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    with pytest.raises(ConfigurationError) as failure:
        check_push(Settings())
    assert "HF_HUB_OFFLINE is set" in without_ways_out(str(failure.value))


def real_hub_answers(answer: httpx.Response | Exception) -> None:
    """Stand in for the real Hub."""

    def respond(request: httpx.Request) -> httpx.Response:
        assert request.url.path == "/api/whoami-v2"
        assert request.headers["authorization"] == "Bearer hf_secret"
        if isinstance(answer, Exception):
            raise answer
        return answer

    set_client_factory(lambda: httpx.Client(transport=httpx.MockTransport(respond)))


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (httpx.ConnectError("no route"), "cannot be reached: no route"),
        (httpx.ReadTimeout("too slow"), "cannot be reached: too slow"),
        (httpx.Response(401, json={"error": "expired"}), "does not accept the login"),
    ],
)
def test_a_push_that_the_real_hub_would_refuse_fails_at_the_start(
    monkeypatch: pytest.MonkeyPatch, answer: httpx.Response | Exception, reason: str
):
    monkeypatch.setenv("HF_TOKEN", "hf_secret")
    real_hub_answers(answer)
    with pytest.raises(ConfigurationError) as failure:
        check_push(Settings())
    assert reason in without_ways_out(str(failure.value))
    assert "hf_secret" not in str(failure.value)


def test_a_working_login_passes(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("HF_TOKEN", "hf_secret")
    real_hub_answers(httpx.Response(200, json={"name": "me"}))
    check_push(Settings())


def test_a_local_hub_passes_and_stays_empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv(routing.LOCAL_HUB, str(tmp_path / "hub"))
    check_push(Settings())
    assert LocalHub(tmp_path / "hub").names() == []
    assert [path.name for path in (tmp_path / "hub" / ".locks").iterdir()] == ["lerobot-hub"]


@pytest.mark.parametrize(("repo_id", "complaint"), [("a/b/c", "repo_name"), ("../x", "alphanumeric")])
def test_a_name_the_hub_would_refuse_fails_at_the_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, repo_id: str, complaint: str
):
    monkeypatch.setenv(routing.LOCAL_HUB, str(tmp_path / "hub"))
    with pytest.raises(ConfigurationError, match=complaint):
        check_push(Settings(repo_id=repo_id))


def test_a_folder_that_cannot_be_written_fails_at_the_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv(routing.LOCAL_HUB, str(tmp_path / "file" / "hub"))
    with pytest.raises(ConfigurationError, match="could not push 'me/act'"):
        check_push(Settings())


def test_the_wait_for_the_real_hub_is_short():
    assert preflight.TIMEOUT <= 10
