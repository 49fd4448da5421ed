"""Processors of `act_chunked`, under the name by which LeRobot finds them."""

from typing import Any

from lerobot_act_chunking.policies.act_chunked.configuration_act_chunked import ActChunkedConfig
from lerobot_act_chunking.policies.processing import Processors, make_processors


def make_act_chunked_pre_post_processors(
    config: ActChunkedConfig, dataset_stats: dict[str, dict[str, Any]] | None = None
) -> Processors:
    """`make_processors`."""
    return make_processors(config, dataset_stats)
