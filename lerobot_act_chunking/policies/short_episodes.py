"""Chunks that are longer than every episode: trained on padding, executed as far as the data teach."""

import logging
from typing import Any

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.chunked_config import ChunkedConfig

logger = logging.getLogger(__name__)


def fit_to_episodes(config: ChunkedConfig, longest_episode: int, *, weights_follow: bool) -> None:
    """Limit ``n_action_steps`` to what episodes can teach, unless it was given; say so in one line.

    What lies behind the end of an episode is padding and teaches nothing. After weights of a checkpoint it is
    what these make of it; without, it is arbitrary and must not move a robot unasked.

    Args:
        config: of the policy to train; changed in place.
        longest_episode: its length [control steps].
        weights_follow: a checkpoint will fill the network.
    """
    timing, name = config.timing, config.length_name
    if timing.control_steps <= longest_episode:
        return
    parts = [
        f"{name}={timing.horizon} reaches beyond the dataset's longest episode ({longest_episode} steps): "
        "what lies behind its end is padding and is not learned"
    ]
    taught = timing.taught_steps(longest_episode)
    if config.n_action_steps > taught:
        parts.append(_limit(config, taught, weights_follow))
    if not weights_follow and (fitting := _fitting(config, longest_episode)):
        parts.append(f"without padding: {fitting}")
    logger.warning("%s", "; ".join(parts))


def _limit(config: ChunkedConfig, taught: int, weights_follow: bool) -> str:
    """Limit ``n_action_steps`` if that is possible without changing what was given; says what was done."""
    limited = _variant(config, n_action_steps=taught)
    if limited is not None and config.given("n_action_steps") is None:
        config.n_action_steps, config.execution = taught, limited.execution
        return limit_text(taught)
    source = "as the checkpoint learned them" if weights_follow else "although nothing taught them"
    return kept_text(config.n_action_steps, taught, source, works=limited is not None)


def limit_text(taught: int) -> str:
    """Says that nothing more is executed than episodes teach."""
    return f"n_action_steps={taught}, so that nothing is executed that was not learned"


def kept_text(used: int, taught: int, source: str, *, works: bool) -> str:
    """Says that more is executed, what it comes from, and the way out if there is one."""
    way_out = f" (--policy.n_action_steps={taught} leaves them out)" if works else ""
    return f"n_action_steps={used} executes steps from {taught} on, {source}{way_out}"


def _fitting(config: ChunkedConfig, longest_episode: int) -> str | None:
    """The option for the longest chunks that fit into the episode, if other settings allow any."""
    timing = config.timing
    for n_predictions in range((longest_episode - 1) // timing.chunk_stride + 1, 0, -1):
        option = {config.length_name: timing.past_steps + n_predictions}
        if config.given("horizon_s") is not None:
            control_steps = (n_predictions - 1) * timing.chunk_stride + 1
            option = {"horizon_s": round(control_steps / (config.fps or 1), 4)}
        if _variant(config, **option) is not None:
            ((name, value),) = option.items()
            return f"--policy.{name}={value}"
    return None


def _variant(config: ChunkedConfig, **changes: Any) -> ChunkedConfig | None:
    try:
        return config.variant(**changes)
    except ConfigurationError:
        return None
