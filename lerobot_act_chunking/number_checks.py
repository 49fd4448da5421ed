"""Refuses numbers that cannot work: fields of policies by their `RANGES`, other settings by a least value."""

import math

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.ranges import RANGES


def check_range(name: str, value: float | list[float] | tuple[float, ...]) -> None:
    """Refuse a number, or a list with one, that the `RANGES` of this field do not allow.

    Raises:
        ConfigurationError: naming the field, the value and what is allowed.
    """
    numbers = value if isinstance(value, list | tuple) else [value]
    if not all(number in RANGES[name] for number in numbers):
        raise ConfigurationError(f"{name}={value} must be {RANGES[name]}")


def check_ranges(spec: object, *names: str) -> None:
    """`check_range` of these fields of an object."""
    for name in names:
        check_range(name, getattr(spec, name))


def check_at_least(least: int, **values: float | None) -> None:
    """Refuse values below ``least``, or infinite, where given.

    Raises:
        ConfigurationError: naming the setting and its value.
    """
    for name, value in values.items():
        if value is not None and not least <= value < math.inf:
            raise ConfigurationError(f"{name}={value} must be at least {least}")


def check_positive(**values: float | None) -> None:
    """Refuse values that must be positive, and finite, where given.

    Raises:
        ConfigurationError: naming the setting and its value.
    """
    for name, value in values.items():
        if value is not None and not 0 < value < math.inf:
            raise ConfigurationError(f"{name}={value} must be a positive number")
