"""Property: a setting that was given is what the configuration says ever after, or it is refused."""

import math
from dataclasses import fields
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np
import pytest
from lerobot.configs import NormalizationMode, PreTrainedConfig
from policy_cases import MODULES, SIZES, TYPES
from tiers import draws

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.choices import choices_of

# LeRobot's own, or files and objects that a drawn value cannot be.
LEFT_OUT = {"device", "use_amp", "rtc_config", "tokenizer_path", "pretrained_backbone_weights"}
LEFT_OUT |= {"inner", "inner_path", "input_features", "output_features", "pretrained_path", "trained_on"}
LEFT_OUT |= {"instructions", "language_encoder"}
INTEGERS = (0, 1, 2, 3, 5, 8, 10, 16, 50, 64, 100)
NUMBERS = (0.0, 1e-4, 0.02, 0.1, 0.3, 0.5, 0.99, 1.0, 2.0, 10.0)
NAMED: dict[str, tuple[Any, ...]] = {
    "preset": ("base", "paper", "autoregressive"),
    "vision_backbone": ("small_cnn", "resnet18", "resnet34"),
    "normalization_mapping": tuple({"ACTION": mode} for mode in NormalizationMode),
    "gripper_dims": ([], [0], [2, 1]),
    "fps": (10.0, 50.0),
}


def values_of(hint: Any) -> tuple[Any, ...]:
    """A few values of a field's type, plausible and not."""
    if get_origin(hint) is Literal:
        return get_args(hint)
    if hint is bool:
        return (False, True)
    if hint is int:
        return INTEGERS
    if hint is float:
        return NUMBERS
    if hint is str:
        return ("other",)
    of = [each for each in get_args(hint) if each not in (type(None), Ellipsis)]
    if get_origin(hint) is tuple:
        return tuple((a, b) for a in values_of(of[0]) for b in values_of(of[0]))
    if get_origin(hint) is list:
        return tuple([value] for value in values_of(of[0]))
    return tuple(value for each in of for value in values_of(each))


def candidates(config_class: type, name: str, hint: Any) -> tuple[Any, ...]:
    return NAMED.get(name) or choices_of(config_class).get(name) or values_of(hint)


def draw(policy_type: str, rng: np.random.Generator) -> dict[str, Any]:
    """One to four settings of a type."""
    config_class = PreTrainedConfig.get_choice_class(policy_type)
    hints = get_type_hints(config_class)
    names = [each.name for each in fields(config_class) if each.name not in LEFT_OUT]
    choices = {name: candidates(config_class, name, hints[name]) for name in names}
    chosen = rng.permutation(names)[: rng.integers(1, 5)]
    return {str(name): choices[name][rng.integers(len(choices[name]))] for name in chosen}


def make(policy_type: str, given: dict[str, Any]) -> PreTrainedConfig:
    needed = getattr(MODULES[policy_type], "NEEDED", {})
    return PreTrainedConfig.get_choice_class(policy_type)(device="cpu", **needed, **given)


def differing(config: PreTrainedConfig, given: dict[str, Any]) -> dict[str, Any]:
    """What the configuration says otherwise than it was told."""
    return {name: getattr(config, name) for name in given if not same(getattr(config, name), given[name])}


def same(is_now: Any, given: Any) -> bool:
    if isinstance(given, dict):  # a partial mapping is completed
        return given.items() <= is_now.items()
    if isinstance(given, tuple | list):
        return list(is_now) == list(given)
    return is_now == given and isinstance(is_now, bool) == isinstance(given, bool)


@pytest.mark.parametrize("policy_type", MODULES)
def test_what_is_given_stays_or_is_refused(policy_type, tmp_path):
    rng, kept, drawn = np.random.default_rng(7), 0, draws(gate=100, full=5000)
    for number in range(drawn):
        given = draw(policy_type, rng)
        try:
            config = make(policy_type, given)
        except ConfigurationError:
            continue
        assert not differing(config, given), given
        kept += 1
        if kept % 5 == 0:
            config.save_pretrained(tmp_path / str(number))
            loaded = PreTrainedConfig.from_pretrained(tmp_path / str(number))
            assert not differing(loaded, given), given
            assert loaded == config
    assert kept > drawn / 4  # the property is about those


@pytest.mark.parametrize("policy_type", TYPES)
def test_every_field_is_left_alone_by_itself(policy_type):
    config_class = PreTrainedConfig.get_choice_class(policy_type)
    hints = get_type_hints(config_class)
    for name in {each.name for each in fields(config_class)} - LEFT_OUT:
        for value in candidates(config_class, name, hints[name]):
            try:
                config = make(policy_type, {name: value})
            except ConfigurationError:
                continue
            assert not differing(config, {name: value}), (name, value)


@pytest.mark.parametrize("policy_type", TYPES)
@pytest.mark.parametrize("execution", ["open_loop", "receding", "ensemble", "crossfade", "adaptive"])
def test_a_single_action_and_a_mode_that_blends_contradict_each_other(policy_type, execution):
    given = {**SIZES[policy_type], "execution": execution, "n_action_steps": 1}
    if execution == "open_loop":
        assert make(policy_type, given).execution == execution
    else:
        with pytest.raises(ConfigurationError, match=f"execution={execution} needs overlapping chunks"):
            make(policy_type, given)
    alone = make(policy_type, {**SIZES[policy_type], "n_action_steps": 1})
    assert (alone.execution, alone.execution_settings.replan_interval) == ("open_loop", 1)


def test_the_law_sees_a_change():
    config = make(TYPES[0], {"chunk_stride": 2})
    config.chunk_stride = 3
    assert differing(config, {"chunk_stride": 2, "use_ema": False}) == {"chunk_stride": 3}
    assert not same(math.nan, 0.1)
