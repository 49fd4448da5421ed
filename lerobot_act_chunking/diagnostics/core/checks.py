"""Checks of what is asked for."""

from lerobot_act_chunking.errors import ConfigurationError


def check_positive(**values: float | None) -> None:
    """Refuse values that must be positive where given.

    Raises:
        ConfigurationError: naming the option and its value.
    """
    for name, value in values.items():
        if value is not None and not 0 < value < float("inf"):
            raise ConfigurationError(f"{name}={value} must be a positive number")
