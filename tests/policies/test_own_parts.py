"""A head, latent, denoiser or tokenizer of one's own is a class and an entry in a table: all else follows."""

from typing import Any

import draccus
import pytest
from command_line import Command
from policy_cases import STATE, TYPES, Case

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


OWN: dict[str, tuple[dict[str, Any], type, dict[str, Any]]] = {
    "action_likelihood": (HEADS, CauchyHead, {}),
    "latent_type": (LATENTS, OwnLatent, {"use_vae": True}),
    "denoiser": (DENOISERS, OwnDenoiser, {}),
    "tokenizer": (TOKENIZERS, OwnTokenizer, {}),
}
USED_BY = {
    field: policy_type
    for policy_type in TYPES
    for field in OWN
    if field in {each.name for each in settings_of(policy_type)}
}
"""The type of policy that has the field, for those that are there."""


@pytest.mark.parametrize("field", USED_BY)
def test_what_is_in_the_table_can_be_asked_for_and_learns(field, monkeypatch):
    table, part, settings = OWN[field]
    case = Case(field, USED_BY[field], STATE, settings)
    with pytest.raises(ConfigurationError, match=f"unknown {field} 'own'; choose one of: {', '.join(table)}"):
        case.config(**{field: "own"})

    monkeypatch.setitem(table, "own", part)
    policy = case.policy(**{field: "own"}).train()
    assert part in map(type, policy.modules())
    loss, metrics = policy.forward(case.batch())
    loss.backward()
    assert any(weight.grad is not None and weight.grad.any() for weight in policy.parameters())
    assert ("own_loss" in metrics) == (field == "action_likelihood")


@pytest.mark.parametrize("field", USED_BY)
def test_what_is_in_the_table_is_allowed_on_the_command_line_and_listed(field, monkeypatch, capsys):
    (table, part, _), policy_type = OWN[field], USED_BY[field]
    monkeypatch.setitem(table, "own", part)
    (allowed,) = (each.allowed for each in settings_of(policy_type) if each.name == field)
    assert allowed == ", ".join(table)
    given = [f"--policy.type={policy_type}", f"--policy.{field}=own"]
    assert getattr(draccus.parse(Command, args=given).policy, field) == "own"
    with pytest.raises(SystemExit):
        draccus.parse(Command, args=["--help"])
    assert f"--policy.{field} {{{','.join(table)}}}" in capsys.readouterr().out
