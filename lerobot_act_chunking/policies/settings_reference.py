"""Every setting of a policy type: what it does, what it may hold, its default, and its value in each preset.

The texts are those of the configurations' docstrings, so that there is one place for them.
"""

import inspect
import re
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from enum import Enum
from typing import Any, Literal, get_args, get_origin

from lerobot.configs import PreTrainedConfig
from lerobot.utils.import_utils import register_third_party_plugins

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.errors import unknown_choice
from lerobot_act_chunking.heads.spec import HeadSpec
from lerobot_act_chunking.policies.choices import choices_of
from lerobot_act_chunking.policies.chunked_config import ChunkedConfig
from lerobot_act_chunking.policies.execution_fields import ExecutionFields
from lerobot_act_chunking.policies.field_checks import own_fields
from lerobot_act_chunking.policies.limit_fields import LimitFields
from lerobot_act_chunking.ranges import RANGES, Range

PACKAGE = "lerobot_act_chunking."
DOCUMENTED = (PACKAGE, "act_chunking_runtime.")
GROUPS = ("this policy", "all policies of this package", "chunk execution")
NOTHING = "null"
_PARTS = (ExecutionSettings, HeadSpec)  # what docstrings refer to by "see `HeadSpec`"
_ENTRY = re.compile(r"    (\w+(?:, \w+)*): (.*)")


@dataclass(frozen=True)
class Setting:
    """One field of a configuration.

    Attributes:
        name: as in ``--policy.<name>``.
        group: one of `GROUPS`.
        meaning: what it does.
        allowed: its kind and its range or choices.
        values: its value by preset, or by ``default`` where there are no presets. ``null → 25``: it is not
            set, and the execution mode takes 25.
    """

    name: str
    group: str
    meaning: str
    allowed: str
    values: Mapping[str, str]


def policy_types() -> dict[str, type[PreTrainedConfig]]:
    """The configuration class of every policy type of this package that LeRobot knows."""
    register_third_party_plugins()
    known = PreTrainedConfig.get_known_choices()
    return {name: each for name, each in known.items() if each.__module__.startswith(PACKAGE)}


def settings_of(policy_type: str, preset: str | None = None) -> list[Setting]:
    """The settings of a policy type in the order of `GROUPS`, in each of them as they are declared.

    Args:
        policy_type: one of `policy_types`.
        preset: only its values; by default those of all presets.

    Raises:
        ConfigurationError: an unknown type or preset.
    """
    types = policy_types()
    if policy_type not in types:
        raise unknown_choice("policy type", policy_type, types)
    config_class = types[policy_type]
    presets = _presets(config_class)
    if preset is not None and preset not in presets:
        raise unknown_choice(f"preset of {policy_type}", preset, presets or ("none, it has no presets",))
    columns = _values(config_class, presets if preset is None else (preset,))
    meanings = _meanings(config_class)
    settings = [
        Setting(
            name=name,
            group=_group(config_class, name),
            meaning=meanings[name],
            allowed=_allowed(
                config_class, name, hint, optional and _may_stay_null(config_class, name, columns)
            ),
            values={column: values[name] for column, values in columns.items()},
        )
        for name, hint, optional in own_fields(config_class)
    ]
    return sorted(settings, key=lambda each: (GROUPS.index(each.group), each.name != "preset"))


def _presets(config_class: type) -> tuple[str, ...]:
    return getattr(config_class, "presets", ())


def _group(config_class: type, name: str) -> str:
    for base, group in ((ExecutionFields, GROUPS[2]), (LimitFields, GROUPS[2]), (ChunkedConfig, GROUPS[1])):
        if issubclass(config_class, base) and name in _declared(base):
            return group
    return GROUPS[0]


def _declared(config_class: type) -> set[str]:
    return {each.name for each in fields(config_class)} - {each.name for each in fields(PreTrainedConfig)}


def _values(config_class: type[Any], presets: tuple[str, ...]) -> dict[str, dict[str, str]]:
    names = [name for name, _, _ in own_fields(config_class)]
    if not presets:
        defaults = {each.name: each for each in fields(config_class)}
        return {"default": {name: _plain(_default(defaults[name])) for name in names}}
    return {preset: _resolved(config_class(preset=preset, device="cpu"), names) for preset in presets}


def _default(each: Any) -> Any:
    return each.default_factory() if each.default_factory is not MISSING else each.default


def _resolved(config: Any, names: list[str]) -> dict[str, str]:
    values = {}
    for name in names:
        values[name] = _plain(getattr(config, name))
        by_mode = getattr(config.execution_settings, name, None)
        if values[name] == NOTHING and by_mode is not None:
            values[name] = f"{NOTHING} → {_plain(by_mode)}"
    return values


def _plain(value: Any) -> str:
    """A value as it is written on the command line."""
    if value is None:
        return NOTHING
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_plain, value))}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{_plain(key)}: {_plain(each)}' for key, each in value.items())}}}"
    return str(value)


def _may_stay_null(config_class: type[Any], name: str, columns: Mapping[str, Mapping[str, str]]) -> bool:
    """Whether null is a value of its own, and does not stand for what the preset decides."""
    (default,) = (each.default for each in fields(config_class) if each.name == name)
    return default is not None or any(values[name].startswith(NOTHING) for values in columns.values())


def _allowed(config_class: type, name: str, hint: Any, nullable: bool) -> str:
    choices = choices_of(config_class).get(name)
    choices = choices or (get_args(hint) if get_origin(hint) is Literal else None)
    if name == "preset":
        choices = _presets(config_class)
    if choices:
        allowed = ", ".join(map(str, choices))
    elif name in RANGES:
        allowed = f"{_kind(hint)}, {_limits(RANGES[name])}"
    else:
        allowed = _kind(hint)
    return f"{allowed}, or {NOTHING}" if nullable else allowed


def _kind(hint: Any) -> str:
    if get_origin(hint) in (list, tuple):
        return f"list of {_kind(get_args(hint)[0])}s"
    if get_origin(hint) is dict:
        return "mapping"
    kinds = {int: "whole number", float: "number", bool: "true or false", str: "text"}
    return kinds.get(hint, getattr(hint, "__name__", "any"))


def _limits(limits: Range) -> str:
    low = f"above {limits.least:g}" if limits.above else f"{limits.least:g}"
    return f"{low} to {'below ' if limits.below else ''}{limits.most:g}"


def _meanings(config_class: type) -> dict[str, str]:
    """What the docstrings of a configuration and of its bases say of each field; the nearest counts."""
    found: dict[str, str] = {}
    for each in (*config_class.__mro__, *_PARTS):
        if each.__module__.startswith(DOCUMENTED):
            for name, text in _entries(each).items():
                if not text.startswith("see `"):
                    found.setdefault(name, text)
    return found


def _entries(documented: type) -> dict[str, str]:
    """The entries under ``Attributes`` of a docstring, each on one line."""
    texts: dict[str, list[str]] = {}
    names: list[str] = []
    inside = False
    for line in (inspect.getdoc(documented) or "").splitlines():
        if line and not line.startswith(" "):
            inside = line.startswith("Attributes")
            continue
        entry = _ENTRY.fullmatch(line) if inside else None
        if entry:
            names = entry[1].split(", ")
            texts |= {name: [entry[2]] for name in names}
        elif inside and line.startswith(" " * 8):
            for name in names:
                texts[name].append(line.strip())
    return {name: " ".join(lines).replace("``", "`") for name, lines in texts.items()}
