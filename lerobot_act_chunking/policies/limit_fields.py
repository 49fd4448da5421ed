"""The settings of what may be executed, under the same names in every policy of this package."""

from dataclasses import dataclass
from typing import Literal

from lerobot_act_chunking.errors import ConfigurationError

DEFAULT_MARGIN = 0.05


@dataclass
class LimitFields:
    """Mixin for policy configurations: what is executed stays within what was demonstrated.

    Attributes:
        action_limits: ``demonstrations`` holds every action that is executed within the range of the
            demonstrated ones; ``none`` does not. What is held back is counted and told. In effect where a
            checkpoint is loaded to act, not while it is trained.
        limit_margin: by how much ``action_limits`` widens the range on both sides, as a share of it; 0.05 by
            default.
        max_speed: the most that an executed action may change in a control step, in multiples of the largest
            demonstrated change, which is 1; of each dimension, and not counting the wildest of 20 episodes.
            By default there is no limit. Likewise counted, told, and in effect.
    """

    action_limits: Literal["none", "demonstrations"] = "none"
    limit_margin: float | None = None
    max_speed: float | None = None

    @property
    def limits_actions(self) -> bool:
        """Whether anything may be held back."""
        return self.action_limits != "none" or self.max_speed is not None

    def check_limits(self) -> None:
        """Refuse a margin of nothing.

        Raises:
            ConfigurationError: naming the settings.
        """
        if self.limit_margin is not None and self.action_limits == "none":
            raise ConfigurationError(
                f"limit_margin={self.limit_margin} has no effect with action_limits=none: set "
                "action_limits=demonstrations, or limit_margin=null"
            )
