"""A huggingface_hub that cannot be routed is left alone, and gets nothing that was meant for a folder."""

import os
import subprocess
import sys
from types import SimpleNamespace

import huggingface_hub
import pytest
from huggingface_hub import constants, get_session
from policy_cases import TYPES
from tiers import full_tier

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.hub import routing
from lerobot_act_chunking.hub.preflight import check_push
from lerobot_act_chunking.hub.transport import LocalHubTransport


def without_factory(patch):
    """huggingface_hub looks its names up when they are asked for."""
    look_up = huggingface_hub.__getattr__

    def without(name):
        if name == "set_client_factory":
            raise AttributeError(f"module 'huggingface_hub' has no attribute {name!r}")
        return look_up(name)

    patch.setattr(huggingface_hub, "__getattr__", without)
    patch.delitem(vars(huggingface_hub), "set_client_factory", raising=False)


MISSING = {
    "set_client_factory": without_factory,
    "HF_HUB_DISABLE_XET": lambda patch: patch.delattr(constants, "HF_HUB_DISABLE_XET"),
    "ENDPOINT": lambda patch: patch.delattr(constants, "ENDPOINT"),
}


@pytest.fixture(params=MISSING)
def unroutable(request, monkeypatch, tmp_path):
    monkeypatch.setenv(routing.LOCAL_HUB, str(tmp_path / "hub"))
    MISSING[request.param](monkeypatch)
    return request.param


def test_it_is_left_alone_with_one_line(unroutable, caplog):
    routing.install()
    assert not isinstance(get_session()._transport, LocalHubTransport)
    (line,) = caplog.messages
    assert line.startswith("the local hub is off and the real Hub is asked: ")
    assert unroutable in line


def test_a_push_that_was_meant_for_the_folder_is_refused_and_training_without_one_is_not(unroutable):
    check_push(SimpleNamespace(push_to_hub=False, repo_id=None))
    with pytest.raises(ConfigurationError, match=f"(?s){unroutable}.*push_to_hub=false"):
        check_push(SimpleNamespace(push_to_hub=True, repo_id="me/act"))


def test_without_the_variable_nothing_is_said(monkeypatch, caplog):
    MISSING["set_client_factory"](monkeypatch)
    monkeypatch.delenv(routing.LOCAL_HUB, raising=False)
    routing.install()
    assert caplog.messages == []


@full_tier
def test_the_plugin_loads_with_neither_reader_nor_hub(tmp_path):
    code = (
        "from huggingface_hub import constants; del constants.HF_HUB_DISABLE_XET;"
        "import lerobot.datasets.lerobot_dataset as module; module.LeRobotDataset.__getitems__ = len;"
        "import lerobot_act_chunking.plugin;"
        "from lerobot.configs import PreTrainedConfig; from lerobot.datasets import factory;"
        f"print({TYPES[0]!r} in PreTrainedConfig.get_known_choices(), factory.LeRobotDataset.__name__)"
    )
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code],
        env={**os.environ, routing.LOCAL_HUB: str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == ["True", "LeRobotDataset"]
    reasons = ("fast chunks are off and LeRobot's own reader is used", "the local hub is off")
    lines = done.stderr.splitlines()
    assert [reason in line for reason, line in zip(reasons, lines, strict=True)] == [True, True]
