"""A head, latent, denoiser or tokenizer of one's own is a class and an entry in a table: all else follows."""

from typing import Any

import draccus
import pytest
from command_line import Command
from policy_cases import STATE, Case

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.heads.make import HEADS
from lerobot_act_chunking.heads.regression import RegressionHead
from lerobot_act_chunking.nn.denoisers.make import DENOISERS
from lerobot_act_chunking.nn.denoisers.mixer import Mixer
from lerobot_act_chunking.nn.latents.conditional import ConditionalLatent
from lerobot_act_chunking.nn.latents.make import LATENTS
from lerobot_act_chunking.policies.settings_reference import settings_of
from lerobot_act_chunking.tokenizers.make import TOKENIZERS
from lerobot_act_chunking.tokenizers.uniform import UniformTokenizer


class CauchyHead(RegressionHead):
    """Errors that count the less the larger they are."""

    def element_loss(self, features, actions):
        return (self(features) - actions).square().log1p()


class OwnLatent(ConditionalLatent):
    pass


class OwnDenoiser(Mixer):
    pass


class OwnTokenizer(UniformTokenizer):
    pass


OWN: dict[str, tuple[dict[str, Any], type, str, dict[str, Any]]] = {
    "action_likelihood": (HEADS, CauchyHead, "act_chunked", {}),
    "latent_type": (LATENTS, OwnLatent, "act_chunked", {"use_vae": True}),
    "denoiser": (DENOISERS, OwnDenoiser, "diffusion_chunked", {}),
    "tokenizer": (TOKENIZERS, OwnTokenizer, "vqbet_chunked", {}),
}


@pytest.mark.parametrize("field", OWN)
def test_what_is_in_the_table_can_be_asked_for_and_learns(field, monkeypatch):
    table, part, policy_type, settings = OWN[field]
    case = Case(field, policy_type, STATE, settings)
    with pytest.raises(ConfigurationError, match=f"unknown {field} 'own'; choose one of: {', '.join(table)}"):
        case.config(**{field: "own"})

    monkeypatch.setitem(table, "own", part)
    policy = case.policy(**{field: "own"}).train()
    assert part in map(type, policy.modules())
    loss, metrics = policy.forward(case.batch())
    loss.backward()
    assert any(weight.grad is not None and weight.grad.any() for weight in policy.parameters())
    assert ("own_loss" in metrics) == (field == "action_likelihood")


@pytest.mark.parametrize("field", OWN)
def test_what_is_in_the_table_is_allowed_on_the_command_line_and_listed(field, monkeypatch, capsys):
    table, part, policy_type, _ = OWN[field]
    monkeypatch.setitem(table, "own", part)
    (allowed,) = (each.allowed for each in settings_of(policy_type) if each.name == field)
    assert allowed == ", ".join(table)
    given = [f"--policy.type={policy_type}", f"--policy.{field}=own"]
    assert getattr(draccus.parse(Command, args=given).policy, field) == "own"
    with pytest.raises(SystemExit):
        draccus.parse(Command, args=["--help"])
    assert f"--policy.{field} {{{','.join(table)}}}" in capsys.readouterr().out
