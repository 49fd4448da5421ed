"""Chunks that are longer than every episode: trained on padding, executed as far as the data teach."""

import logging
from typing import Any

from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.chunked_config import ChunkedConfig
from lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble import (
    TemporalEnsembleConfig,
)

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


def limit_execution(config: TemporalEnsembleConfig, longest_episode: int) -> None:
    """The same for a wrapper around a policy of any type that is trained from its beginnings."""
    inner, chunk_size = config.inner_config, config.chunk_size
    timing = inner.timing if isinstance(inner, ChunkedConfig) else ChunkTiming(1, chunk_size)
    taught = timing.taught_steps(longest_episode)
    used = config.n_action_steps or chunk_size
    if used <= taught:
        return
    try:
        config.resolve_execution(chunk_size, taught)
        works = True
    except ConfigurationError:
        works = False
    if works and config.n_action_steps is None:
        config.n_action_steps = taught
        what = _limited(taught)
    else:
        what = _kept(used, taught, "although nothing taught them", works=works)
    logger.warning(
        "temporal_ensemble: the inner %s predicts %d steps, more than the dataset's longest episode has "
        "(%d steps); %s",
        inner.type,
        chunk_size,
        longest_episode,
        what,
    )


def _limit(config: ChunkedConfig, taught: int, weights_follow: bool) -> str:
    """Limit ``n_action_steps`` if that is possible without changing what was given; says what was done."""
    limited = _variant(config, n_action_steps=taught)
    if limited is not None and config.given("n_action_steps") is None:
        config.n_action_steps, config.execution = taught, limited.execution
        return _limited(taught)
    source = "as the checkpoint learned them" if weights_follow else "although nothing taught them"
    return _kept(config.n_action_steps, taught, source, works=limited is not None)


def _limited(taught: int) -> str:
    return f"n_action_steps={taught}, so that nothing is executed that was not learned"


def _kept(used: int, taught: int, source: str, *, works: bool) -> str:
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
