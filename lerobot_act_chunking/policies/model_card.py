"""Model cards that say how a policy acts, wherever LeRobot makes them."""

import logging
from typing import Any

from lerobot_act_chunking import compat
from lerobot_act_chunking.hub.card import extend_card
from lerobot_act_chunking.policies.execution_fields import ExecutionFields

logger = logging.getLogger(__name__)


class WithModelCard:
    """A policy whose card has LeRobot's text, plus what it reads and how it acts."""

    config: Any

    def generate_model_card(self, *args: Any, dataset_meta: Any | None = None, **kwargs: Any) -> Any:
        """LeRobot's model card, plus what this policy reads and how it acts."""
        card = compat.model_card(self, *args, dataset_meta=dataset_meta, **kwargs)
        return _extended(card, self.config, dataset_meta)


def install() -> None:
    """Extend our policies' cards where LeRobot makes them outside of policies; harmless when repeated."""
    try:
        compat.extend_model_cards(_extended)
    except (ImportError, AttributeError) as error:
        logger.warning("model cards do not say how a policy acts: %s", error)


def _extended(card: Any, config: Any, dataset_meta: Any | None) -> Any:
    if not isinstance(config, ExecutionFields):
        return card
    return extend_card(card, config, fps=None if dataset_meta is None else dataset_meta.fps)  # pyright: ignore[reportArgumentType]
