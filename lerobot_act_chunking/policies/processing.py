"""Processors of this package's policies: LeRobot's own steps over statistics with a least spread."""

import copy
from typing import Any

from lerobot.processor import PolicyAction, PolicyProcessorPipeline, make_default_pre_post_processors

from lerobot_act_chunking.policies.chunked_config import ChunkedConfig
from lerobot_act_chunking.policies.language.tokens import InstructionTokens
from lerobot_act_chunking.policies.statistics import check_statistics, floored_statistics

Processors = tuple[
    PolicyProcessorPipeline[dict[str, Any], dict[str, Any]],
    PolicyProcessorPipeline[PolicyAction, PolicyAction],
]


def make_processors(
    config: ChunkedConfig, dataset_stats: dict[str, dict[str, Any]] | None = None
) -> Processors:
    """Rename, batch, move, normalise and tokenise a task that is read before the policy; the reverse behind.

    The steps are LeRobot's, under LeRobot's names, but for `InstructionTokens`. `norm_std_floor` is applied
    to the statistics they hold, so a checkpoint carries the floored ones and resuming keeps them. When
    fine-tuning from a checkpoint, LeRobot replaces them by the new dataset's raw statistics, without a floor;
    nothing in a policy's reach changes that.

    Raises:
        DatasetError: if a statistic is missing, not finite, or no spread.
    """
    config = copy.copy(config)
    config.keep_what_is_read()
    if dataset_stats is not None:
        check_statistics(config, dataset_stats)
        dataset_stats = floored_statistics(config, dataset_stats, config.norm_std_floor)
    before, behind = make_default_pre_post_processors(config, dataset_stats, normalizer_device=config.device)
    if config.task_tokens is not None:
        before.steps = [*before.steps, InstructionTokens(*config.task_tokens)]
    return before, behind
