"""Refuses numbers below what can work, for settings that are no fields of a policy (`ranges`)."""

import math

from act_chunking_runtime.errors import ConfigurationError


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
