"""Small policies of every type there is; a new one adds ``cases_<type>.py`` and inherits the shared tests."""

from importlib import import_module
from pathlib import Path
from typing import Any

from lerobot.configs import PreTrainedConfig
from policy_case import (  # noqa: F401
    ENVIRONMENT,
    KINDS,
    STATE,
    TOP,
    VELOCITY,
    WRIST,
    A,
    B,
    Case,
    T,
    history_batch,
)

from lerobot_act_chunking import policies

MODULES = {}
"""What each type's tests bring to the shared ones, by type."""
for _file in sorted(Path(__file__).parent.glob("cases_*.py")):
    _type = _file.stem.removeprefix("cases_")
    import_module(f"{policies.__name__}.{_type}.configuration_{_type}")  # registers the type
    MODULES[_type] = _module = import_module(_file.stem)
    if hasattr(_module, "KIND"):
        KINDS[_type] = _module.KIND


def of_every_type(topic: str) -> list[Any]:
    """The lists of this name in all ``cases_<type>.py`` that have one."""
    return [each for module in MODULES.values() for each in getattr(module, topic, ())]


TYPES = list(KINDS)
CASES: list[Case] = of_every_type("CASES")
WRAPPED: list[Case] = of_every_type("WRAPPED")
"""Policies that execute another one's chunks."""
SIZES = {name: kind.sizes for name, kind in KINDS.items()}
LENGTHS = {name: "chunk_size" if "chunk_size" in sizes else "horizon" for name, sizes in SIZES.items()}
"""What each type calls the number of its predictions."""


def any_config(**settings: Any) -> PreTrainedConfig:
    """A small configuration for tests that are about no type in particular."""
    config_class = PreTrainedConfig.get_choice_class(TYPES[0])
    return config_class(device="cpu", push_to_hub=False, **SIZES[TYPES[0]] | settings)
