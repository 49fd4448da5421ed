"""Fields whose values are the names of a table, such as that of the action heads."""

from collections.abc import Collection, Mapping
from dataclasses import field, fields
from typing import Any


def one_of(names: Collection[str], default: str | None) -> Any:
    """A field of a configuration that holds one of ``names``; the command line's ``--help`` lists them.

    Args:
        names: a table by name. It may grow: what counts is in it when a configuration is made.
        default: None if the preset decides; the command line does not take null.
    """
    return field(default=default, metadata={"custom_args": {"choices": names}})  # as draccus reads it


def choices_of(config_class: Any) -> Mapping[str, tuple[str, ...]]:
    """The names that each field allows, of those that hold a name."""
    listed = {each.name: each.metadata.get("custom_args", {}) for each in fields(config_class)}
    of_tables = {name: tuple(args["choices"]) for name, args in listed.items() if "choices" in args}
    return getattr(config_class, "choices", {}) | of_tables
