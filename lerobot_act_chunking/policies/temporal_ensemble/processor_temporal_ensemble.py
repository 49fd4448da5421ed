"""Processors of `temporal_ensemble`: the inner policy's own."""

from typing import Any

from lerobot.policies.factory import make_pre_post_processors
from lerobot.processor import (
    AbsoluteActionsProcessorStep,
    PolicyAction,
    PolicyProcessorPipeline,
    RelativeActionsProcessorStep,
)
from lerobot.processor.delta_action_processor import (
    MapDeltaActionToRobotActionStep,
    MapTensorToDeltaActionDictStep,
)

from lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble import (
    TemporalEnsembleConfig,
)
from lerobot_act_chunking.policies.temporal_ensemble.inner import relative_actions

RELATIVE_STEPS = (
    RelativeActionsProcessorStep,
    AbsoluteActionsProcessorStep,
    MapDeltaActionToRobotActionStep,
    MapTensorToDeltaActionDictStep,
)


def make_temporal_ensemble_pre_post_processors(
    config: TemporalEnsembleConfig,
    dataset_stats: dict[str, dict[str, Any]] | None = None,
    dataset_meta: Any | None = None,
) -> tuple[
    PolicyProcessorPipeline[dict[str, Any], dict[str, Any]],
    PolicyProcessorPipeline[PolicyAction, PolicyAction],
]:
    """Load the inner checkpoint's processors, or make the inner policy's for a dataset.

    A checkpoint's statistics are kept, also when training goes on with another dataset: its weights were
    learned under them.

    Raises:
        ConfigurationError: the processors make actions relative to the robot's state.
    """
    inner, source = config.inner_config, config.inner_source
    if source is None:
        processors = make_pre_post_processors(inner, dataset_stats=dataset_stats, dataset_meta=dataset_meta)
    else:
        device = {"device_processor": {"device": str(config.device)}}
        processors = make_pre_post_processors(inner, pretrained_path=source, preprocessor_overrides=device)
    for pipeline in processors:
        if any(_is_relative(step) for step in pipeline.steps):
            raise relative_actions(inner.type)
    return processors


def _is_relative(step: Any) -> bool:
    if isinstance(step, RELATIVE_STEPS):
        return getattr(step, "enabled", True)
    return bool(getattr(step, "use_relative_action", False))  # GR00T's
