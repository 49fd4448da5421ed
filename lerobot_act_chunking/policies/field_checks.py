"""Refuses values of the wrong kind or out of range, field by field, before anything is made of them."""

import math
from dataclasses import fields
from enum import Enum
from functools import cache
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from lerobot.configs import PreTrainedConfig

from lerobot_act_chunking.errors import ConfigurationError, unknown_choice
from lerobot_act_chunking.policies.choices import choices_of
from lerobot_act_chunking.ranges import RANGES, check_ranges

# LeRobot answers for its own fields, but this one is a number of ours, too.
_SHARED = ("n_obs_steps",)

_KINDS = {int: "a whole number", float: "a finite number", bool: "true or false", str: "a text"}


def check_fields(config: PreTrainedConfig) -> None:
    """Refuse a value that its field's annotation, its choices or its `RANGES` do not allow.

    Fields that are None by default may be None: the preset decides them later, or they are left out. So may
    those whose annotation has it.

    Raises:
        ConfigurationError: naming the field, the value and what is allowed.
    """
    choices = choices_of(type(config))
    for name, hint, optional in own_fields(type(config)):
        value = getattr(config, name)
        if value is None and optional:
            continue
        if name in choices and value not in choices[name]:
            raise unknown_choice(name, value, choices[name])
        _check(name, value, hint)
        if name in RANGES:
            check_ranges(config, name)


@cache
def own_fields(config_class: type) -> tuple[tuple[str, Any, bool], ...]:
    """Name and annotation of each field that is ours, and whether it may be None."""
    hints = get_type_hints(config_class)
    lerobots = {each.name for each in fields(PreTrainedConfig)} - set(_SHARED)
    ours = [each for each in fields(config_class) if each.name not in lerobots]
    return tuple(
        (each.name, _without_none(hints[each.name]), each.default is None or has_none(hints[each.name]))
        for each in ours
    )


def has_none(hint: Any) -> bool:
    """Whether an annotation allows None."""
    return get_origin(hint) in (Union, UnionType) and NoneType in get_args(hint)


def _without_none(hint: Any) -> Any:
    if has_none(hint):
        (hint,) = (each for each in get_args(hint) if each is not NoneType)
    return hint


def _check(name: str, value: Any, hint: Any) -> None:
    if get_origin(hint) is Literal:
        if value not in get_args(hint):
            raise unknown_choice(name, value, get_args(hint))
    elif not _fits(value, hint):
        limits = f", {RANGES[name]}" if name in RANGES else ""
        raise ConfigurationError(f"{name}={value!r} must be {_described(hint)}{limits}")


def _fits(value: Any, hint: Any) -> bool:
    origin, inner = get_origin(hint), get_args(hint)
    if hint is int:
        return isinstance(value, int) and not isinstance(value, bool)
    if hint is float:
        whole = isinstance(value, int) and not isinstance(value, bool)
        return whole or (isinstance(value, float) and math.isfinite(value))
    if origin in (list, tuple):  # JSON has no tuples
        fixed = origin is tuple and Ellipsis not in inner
        right_length = not fixed or (isinstance(value, list | tuple) and len(value) == len(inner))
        return isinstance(value, list | tuple) and right_length and all(_fits(v, inner[0]) for v in value)
    if origin is dict:
        return isinstance(value, dict) and all(_fits(v, inner[1]) for v in value.values())
    if isinstance(hint, type) and issubclass(hint, Enum):  # by its value, too, as in JSON
        return value in list(hint)
    return hint is Any or isinstance(value, hint)


def _described(hint: Any) -> str:
    origin, inner = get_origin(hint), get_args(hint)
    if origin is tuple and Ellipsis not in inner:
        return f"a list of {len(inner)} values, each {_described(inner[0])}"
    if origin in (list, tuple):
        return f"a list, each value {_described(inner[0])}"
    if origin is dict:
        return f"a mapping from texts, each value {_described(inner[1])}"
    return _KINDS.get(hint, getattr(hint, "__name__", str(hint)))
