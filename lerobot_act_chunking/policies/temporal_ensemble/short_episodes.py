"""An inner policy whose chunks are longer than every episode, trained from its beginnings."""

import logging

from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.chunked_config import ChunkedConfig
from lerobot_act_chunking.policies.short_episodes import kept_text, limit_text
from lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble import (
    TemporalEnsembleConfig,
)

logger = logging.getLogger(__name__)


def limit_execution(config: TemporalEnsembleConfig, longest_episode: int) -> None:
    """Limit ``n_action_steps`` for an inner policy of any type, as `fit_to_episodes` does for ours."""
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
        what = limit_text(taught)
    else:
        what = kept_text(used, taught, "although nothing taught them", works=works)
    logger.warning(
        "temporal_ensemble: the inner %s predicts %d steps, more than the dataset's longest episode has "
        "(%d steps); %s",
        inner.type,
        chunk_size,
        longest_episode,
        what,
    )
