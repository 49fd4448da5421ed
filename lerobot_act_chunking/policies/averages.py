"""Averaged weights of checkpoints."""

from typing import Any


def adopt_average(policy: Any, incompatible: Any) -> None:
    """Let a checkpoint and the policy that loads it differ in `use_ema`.

    After weights without an average, one starts at them; an average that is not wanted is left behind.
    """
    without_average = [key for key in incompatible.missing_keys if not key.startswith("ema.")]
    if policy.ema is not None and len(without_average) < len(incompatible.missing_keys):
        policy.ema.restart(policy.model)
    incompatible.missing_keys[:] = without_average
    if policy.ema is None:
        unexpected = [key for key in incompatible.unexpected_keys if not key.startswith("ema.")]
        incompatible.unexpected_keys[:] = unexpected
