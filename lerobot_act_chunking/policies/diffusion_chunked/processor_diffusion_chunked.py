"""Processors of `diffusion_chunked`, under the name by which LeRobot finds them."""

from typing import Any

from lerobot_act_chunking.policies.diffusion_chunked.configuration_diffusion_chunked import (
    DiffusionChunkedConfig,
)
from lerobot_act_chunking.policies.processing import Processors, make_processors


def make_diffusion_chunked_pre_post_processors(
    config: DiffusionChunkedConfig, dataset_stats: dict[str, dict[str, Any]] | None = None
) -> Processors:
    """`make_processors`."""
    return make_processors(config, dataset_stats)
