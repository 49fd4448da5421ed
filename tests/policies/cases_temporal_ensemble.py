"""Cases of `temporal_ensemble`, over the first policy type that is there."""

from dataclasses import dataclass, fields
from importlib import import_module
from typing import Any

from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from policy_case import ENVIRONMENT, KINDS, STATE, VELOCITY, A, Case, Kind

from lerobot_act_chunking.policies.execution_fields import ExecutionFields
from lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble import (
    TemporalEnsembleConfig,
)

INNER = next(iter(KINDS))


@dataclass(frozen=True)
class WrappedCase(Case):
    """A policy as the inner one of a `temporal_ensemble`."""

    inner_type: str = INNER

    @property
    def kind(self) -> Kind:
        return KINDS[self.inner_type]

    def config(self, **overrides: Any) -> PreTrainedConfig:
        own = {each.name for each in fields(ExecutionFields)} | {"n_action_steps"}
        execution = {name: overrides.pop(name) for name in own & overrides.keys()}
        return TemporalEnsembleConfig(
            inner={"type": self.inner_type, **self.kind.sizes, **self.settings, **overrides},
            input_features=dict(self.inputs),
            output_features={"action": PolicyFeature(FeatureType.ACTION, (A,))},
            device="cpu",
            push_to_hub=False,
            **execution,
        )


WRAPPED = [WrappedCase("vectors", "temporal_ensemble", STATE | VELOCITY | ENVIRONMENT, {"use_ema": True})]
_DRAWING = import_module(f"cases_{INNER}").DRAWING
SAMPLING = [WrappedCase("sampled", "temporal_ensemble", STATE, _DRAWING)]
NEEDED = {"inner": {"type": INNER, **KINDS[INNER].sizes}}  # no configuration without
