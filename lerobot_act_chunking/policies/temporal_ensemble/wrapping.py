"""Wrapping a checkpoint from Python."""

from pathlib import Path
from typing import Any

from lerobot_act_chunking.policies.loading import LoadedPolicy, check_complete, explained


def load_wrapped(path: str | Path, **settings: Any) -> LoadedPolicy:
    """Load a checkpoint of any policy type with its processors, and execute its chunks as ``settings`` say.

    Args:
        path: checkpoint folder (``…/pretrained_model``) or repo id.
        settings: fields of `TemporalEnsembleConfig`, such as ``execution``, ``replan_interval``, ``device``.

    Raises:
        ConfigurationError: there is no such checkpoint, or it cannot be executed in this way.
    """
    from lerobot.policies.factory import make_pre_post_processors
    from lerobot.utils.import_utils import register_third_party_plugins

    from lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble import (
        TemporalEnsembleConfig,
    )
    from lerobot_act_chunking.policies.temporal_ensemble.modeling_temporal_ensemble import (
        TemporalEnsemblePolicy,
    )

    register_third_party_plugins()
    config = TemporalEnsembleConfig(inner_path=str(path), **{"push_to_hub": False, **settings})
    check_complete(str(path), config.inner_config.type)
    with explained(str(path)):
        processors = make_pre_post_processors(config)
        return LoadedPolicy(TemporalEnsemblePolicy(config).eval(), *processors)
