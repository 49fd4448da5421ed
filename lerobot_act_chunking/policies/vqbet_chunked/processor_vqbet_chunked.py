"""Processors of `vqbet_chunked`, under the name by which LeRobot finds them."""

from typing import Any

from lerobot_act_chunking.policies.processing import Processors, make_processors
from lerobot_act_chunking.policies.vqbet_chunked.configuration_vqbet_chunked import VqbetChunkedConfig


def make_vqbet_chunked_pre_post_processors(
    config: VqbetChunkedConfig, dataset_stats: dict[str, dict[str, Any]] | None = None
) -> Processors:
    """`make_processors`."""
    return make_processors(config, dataset_stats)
