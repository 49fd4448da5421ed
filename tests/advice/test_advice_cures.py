"""Property: advice that names a setting is followed word by word, and cures."""

import re
from typing import Any, get_args, get_type_hints

import pytest
import yaml
from lerobot.configs import PreTrainedConfig
from policy_cases import of_every_type

from lerobot_act_chunking.errors import ConfigurationError

OPTION = r"(?:--policy\.)?([a-z_]+)=([\w.-]+\w|\w)"
Settings = dict[str, Any]

# What provokes an error whose text names the way out; the rest of the test is mechanical.
PROVOKED: list[tuple[str, Settings]] = of_every_type("PROVOKED")
NAMES = [f"{kind}-{'-'.join(given)}-{place}" for place, (kind, given) in enumerate(PROVOKED)]


def make(policy_type: str, given: Settings) -> PreTrainedConfig:
    config_class = PreTrainedConfig.get_choice_class(policy_type)
    hints = get_type_hints(config_class)
    floats = {name for name in given if float in (hints[name], *get_args(hints[name]))}
    as_parsed = {name: float(given[name]) for name in floats if given[name] is not None}  # from "1", too
    return config_class(device="cpu", push_to_hub=False, **{**given, **as_parsed})


def advised(message: str) -> list[Settings]:
    """The settings that a message advises, one dictionary for each way out.

    Advice stands behind its last ": set". Ways out are parted by "or"; what belongs together is not.
    """
    _, _, advice = message.rpartition(": set ")
    parts = re.split(r",? or (?!more|less)", advice)
    found = [{name: yaml.safe_load(value) for name, value in re.findall(OPTION, part)} for part in parts]
    return [way for way in found if way]


@pytest.mark.parametrize(("policy_type", "given"), PROVOKED, ids=NAMES)
def test_every_way_out_leads_out(policy_type, given):
    with pytest.raises(ConfigurationError) as error:
        make(policy_type, given)
    message = str(error.value)
    ways = advised(message)
    assert ways, message
    for way in ways:
        make(policy_type, {**given, **way})
