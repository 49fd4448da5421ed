"""A run that could not push is refused when it starts; nothing else asks the Hub."""

import pytest
from huggingface_hub import constants

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.hub import preflight
from lerobot_act_chunking.policies.act_chunked.configuration_act_chunked import ActChunkedConfig
from lerobot_act_chunking.policies.diffusion_chunked.configuration_diffusion_chunked import (
    DiffusionChunkedConfig,
)
from lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble import (
    TemporalEnsembleConfig,
)
from lerobot_act_chunking.policies.vqbet_chunked.configuration_vqbet_chunked import VqbetChunkedConfig

MAKE = {
    "act_chunked": ActChunkedConfig,
    "diffusion_chunked": DiffusionChunkedConfig,
    "vqbet_chunked": VqbetChunkedConfig,
    "temporal_ensemble": lambda **settings: TemporalEnsembleConfig(inner={"type": "act_chunked"}, **settings),
}


@pytest.fixture(params=MAKE)
def config(request, monkeypatch):
    monkeypatch.delenv("LEROBOT_LOCAL_HUB", raising=False)
    return MAKE[request.param](device="cpu", push_to_hub=True, repo_id="me/policy")


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
