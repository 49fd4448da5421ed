"""Limits of what a policy executes, from the demonstrations that its checkpoint remembers."""

import weakref
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lerobot.processor import PolicyProcessorPipeline
from lerobot.processor.converters import policy_action_to_transition, transition_to_policy_action
from lerobot.utils.constants import ACTION
from torch import Tensor

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.execution.limits import ActionLimits
from lerobot_act_chunking.policies.limit_fields import DEFAULT_MARGIN
from lerobot_act_chunking.policies.loading import PROCESSORS, explained
from lerobot_act_chunking.policies.trained_on import TrainedOn


class ActsWithinLimits:
    """What policies do about the limits of their configuration.

    Attributes:
        limits: of what is executed; None for none.
    """

    limits: ActionLimits | None = None

    def set_limits(self, path: str | Path, **source: Any) -> None:
        """Read the limits that the configuration asks for; what they held back is told when the policy goes.

        Args:
            path: of the checkpoint, a folder or a repo id.
            source: LeRobot's further arguments to find it.

        Raises:
            ConfigurationError: the checkpoint does not know its demonstrations.
        """
        config: Any = self.config  # pyright: ignore[reportAttributeAccessIssue]
        if config.limits_actions:
            self.limits = limits_of(config, *action_units(path, config.action_feature.shape[0], **source))
            weakref.finalize(self, self.limits.report)

    def within_limits(self, action: Tensor) -> Tensor:
        """The normalised action (B, A) that is executed."""
        return action if self.limits is None else self.limits.normalised(action)


def limits_of(config: Any, scale: Tensor, offset: Tensor) -> ActionLimits:
    """The limits that a configuration asks for.

    Args:
        config: with ``trained_on``.
        scale: of a normalised action's units in the robot's (A,).
        offset: what a normalised 0 is.

    Raises:
        ConfigurationError: it does not remember the numbers.
    """
    known, endless = config.trained_on or TrainedOn(), torch.full_like(scale, torch.inf)
    low, high, change = -endless, endless, endless
    if config.action_limits == "demonstrations":
        if ACTION not in known.low:
            raise _unknown("action_limits=demonstrations", "range", "action_limits=none")
        margin = DEFAULT_MARGIN if config.limit_margin is None else config.limit_margin
        widened = torch.tensor(margin * known.spans(ACTION)).to(scale)
        low, high = scale.new_tensor(known.low[ACTION]), scale.new_tensor(known.high[ACTION])
        low, high = low - widened, high + widened
    if config.max_speed is not None:
        if not known.largest_change:
            raise _unknown(f"max_speed={config.max_speed}", "speed", "max_speed=null")
        change = config.max_speed * torch.tensor(np.array(known.largest_change)).to(scale)
    names = action_names(config)
    return ActionLimits(names, low=low, high=high, change=change, scale=scale, offset=offset)


def action_names(config: Any) -> list[str]:
    """Of the action's dimensions, as the demonstrations have them, or else by number."""
    (n_dims,) = config.action_feature.shape
    known = config.trained_on or TrainedOn()
    return list(known.names.get(ACTION) or (f"action {dim}" for dim in range(n_dims)))


def _unknown(setting: str, what: str, otherwise: str) -> ConfigurationError:
    return ConfigurationError(
        f"{setting}: this checkpoint does not know the {what} of its demonstrations; it is from before "
        "policies remembered it, or was not trained by this package. One more training step writes it down: "
        f"lerobot-train --policy.path=<checkpoint> --steps=1 with the same dataset; or set {otherwise}"
    )


def action_units(path: str | Path, n_dims: int, **source: Any) -> tuple[Tensor, Tensor]:
    """What a checkpoint's processors make of normalised actions: scale and offset (A,).

    Args:
        path: of the checkpoint.
        n_dims: A.
        source: LeRobot's further arguments to find it.

    Raises:
        ConfigurationError: there are no processors, or they do more than to scale and shift.
    """
    with explained(str(path)):
        postprocessor = PolicyProcessorPipeline.from_pretrained(
            str(path),
            PROCESSORS[1],
            to_transition=policy_action_to_transition,
            to_output=transition_to_policy_action,
            **source,
        )
        units = scale_and_offset(postprocessor, n_dims)
    if units is None:
        raise ConfigurationError(
            f"{path}: its processors do more to actions than to scale and shift them, so what the robot gets "
            "cannot be limited here: set action_limits=none and max_speed=null"
        )
    return units


def scale_and_offset(
    postprocessor: Any, n_dims: int, dtype: torch.dtype = torch.float32
) -> tuple[Tensor, Tensor] | None:
    """What a postprocessor makes of normalised actions, (A,) each; None if it does more than that."""
    zero, one, opposite = (
        postprocessor(torch.full((1, n_dims), value, dtype=dtype))[0] for value in (0.0, 1.0, -1.0)
    )
    linear = torch.allclose(one + opposite, 2 * zero, rtol=1e-4, atol=1e-5)
    return (one - zero, zero) if linear else None
