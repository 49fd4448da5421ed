"""A run that could not push is refused when it starts; nothing else asks the Hub."""

import pytest
from huggingface_hub import constants
from policy_cases import CASES, WRAPPED

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.hub import preflight

ONE_OF_EACH = {case.type: case for case in [*CASES, *WRAPPED]}


@pytest.fixture(params=ONE_OF_EACH)
def config(request, monkeypatch):
    monkeypatch.delenv("LEROBOT_LOCAL_HUB", raising=False)
    config = ONE_OF_EACH[request.param].config(push_to_hub=True)
    config.push_to_hub, config.repo_id = True, "me/policy"
    return config


@pytest.fixture
def requests(monkeypatch):
    """Counts what asks the real Hub; it has no answer."""
    asked = []

    def session():
        asked.append("the Hub")
        raise OSError("no network")

    monkeypatch.setattr(preflight, "get_session", session)
    monkeypatch.setattr(preflight, "get_token", lambda: "hf_token")
    return asked


def test_offline_nobody_is_asked(config, requests, monkeypatch):
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    with pytest.raises(ConfigurationError, match=r"HF_HUB_OFFLINE is set[\s\S]*push_to_hub=false"):
        config.get_optimizer_preset()
    assert requests == []


def test_the_optimizer_itself_asks_nobody(config, requests, monkeypatch):
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False)
    optimizer = config.training_optimizer()
    assert requests == []
    with pytest.raises(ConfigurationError, match="cannot be reached: no network"):
        config.get_optimizer_preset()
    assert requests == ["the Hub"]
    config.push_to_hub = False
    assert config.get_optimizer_preset() == optimizer
    assert requests == ["the Hub"]
