"""Chunks whose first actions are given, of policies that predict them at once."""

import math
from typing import Any

from lerobot_act_chunking.errors import ConfigurationError


def prefix_predictions(config: Any) -> int:
    """How many of a chunk's first predictions ``prefix_steps`` control steps are."""
    return min(math.ceil(config.prefix_steps / config.chunk_stride), config.timing.chunk_size - 1)


def check_prefix(config: Any) -> None:
    """Refuse a prefix that leaves nothing to predict, or that is shorter than the delay it is for.

    Raises:
        ConfigurationError: naming the value and the way out.
    """
    prefix, control_steps = config.prefix_steps, config.timing.control_steps
    if prefix >= control_steps:
        raise ConfigurationError(
            f"prefix_steps={prefix} leaves nothing to predict: a chunk covers {control_steps} control steps: "
            f"set --policy.prefix_steps to {max(1, control_steps // 4)} or less"
        )
    latency = config.execution_settings.latency_steps
    if prefix and latency > prefix:
        raise ConfigurationError(
            f"latency_steps={latency} needs a policy that was trained with prefix_steps of at least as much, "
            f"not {prefix}: train one with --policy.prefix_steps={latency}"
        )
