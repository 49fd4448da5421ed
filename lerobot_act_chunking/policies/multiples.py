"""Fields that must be multiples of something, and the values near by that are."""

import math
from typing import Any

from lerobot_act_chunking.errors import ConfigurationError


def check_divides(config: Any, count: str, divisor: str, also: int = 1) -> None:
    """Refuse a ``count`` that is not a multiple of its ``divisor`` (both names of fields).

    Args:
        config: whose fields they are.
        count: the field that is divided.
        divisor: the field that divides it.
        also: what ``count`` has to be a multiple of beside.

    Raises:
        ConfigurationError: naming the values to either side that would do.
    """
    n, d = getattr(config, count), getattr(config, divisor)
    if n % d:
        ways_out = f"set --policy.{count} to {_multiples(n, math.lcm(d, also))}"
        if n % also == 0:
            ways_out += f", or --policy.{divisor} to {_divisors(n, d)}"
        raise ConfigurationError(f"{count}={n} must be divisible by {divisor}={d}: {ways_out}")


def check_multiple(config: Any, name: str, step: int, reason: str) -> None:
    """Refuse a field that is not a multiple of ``step``, for this reason.

    Raises:
        ConfigurationError: naming the values to either side that would do.
    """
    value = getattr(config, name)
    if value % step:
        raise ConfigurationError(
            f"{name}={value} must be a multiple of {step}: {reason}; set --policy.{name} to "
            f"{_multiples(value, step)}"
        )


def _multiples(number: int, step: int) -> str:
    below = number // step * step
    return " or ".join(str(each) for each in (below, below + step) if each)


def _divisors(number: int, divisor: int) -> str:
    below = max(each for each in range(1, min(divisor, number) + 1) if number % each == 0)
    above = [each for each in range(divisor, number + 1) if number % each == 0][:1]
    return " or ".join(str(each) for each in (below, *above))
