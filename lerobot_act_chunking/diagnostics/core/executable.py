"""A checkpoint as something that can be executed in many ways."""

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from typing import Any

from lerobot_act_chunking.diagnostics.core.digests import checkpoint_digest
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.chunked_config import ChunkedConfig
from lerobot_act_chunking.policies.dataset_defaults import PRESETS_FPS, spaced_stride
from lerobot_act_chunking.policies.loading import LoadedPolicy, load_policy, read_config
from lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble import (
    TemporalEnsembleConfig,
)
from lerobot_act_chunking.policies.temporal_ensemble.inner import DETERMINISTIC
from lerobot_act_chunking.policies.temporal_ensemble.wrapping import load_wrapped

FIELDS = (
    "execution",
    "n_action_steps",
    "replan_interval",
    "ensemble_weighting",
    "temporal_ensemble_coeff",
    "crossfade_steps",
    "adaptive_kernel",
    "adaptive_scale",
    "n_samples",
    "smoothing_steps",
)
"""The fields of a configuration that say how chunks are executed; latency and grippers are the robot's."""
STEPS = "num_inference_steps"


@dataclass(frozen=True)
class Executable:
    """A checkpoint whose chunks can be executed as one likes.

    Attributes:
        checkpoint: folder or repo id.
        config: the policy's, or a wrapper's around it where its own cannot say how chunks are executed.
        wrapped: whether it is such a wrapper's.
    """

    checkpoint: str
    config: Any
    wrapped: bool

    @property
    def policy_type(self) -> str:
        """Of the checkpoint."""
        return self.config.inner_config.type if self.wrapped else self.config.type

    def load(self) -> LoadedPolicy:
        """The policy, ready to be executed in other ways."""
        return load_wrapped(self.checkpoint) if self.wrapped else load_policy(self.checkpoint)


def read_executable(checkpoint: str) -> Executable:
    """What can be executed of a checkpoint, as it executes itself now; no weights are read.

    Raises:
        ConfigurationError: no such checkpoint, or one that predicts no chunks.
    """
    config = read_config(checkpoint)
    wrapped = not isinstance(config, ChunkedConfig | TemporalEnsembleConfig)
    if wrapped:
        config = TemporalEnsembleConfig(
            inner_path=checkpoint, push_to_hub=False, **_own_execution(config, checkpoint)
        )
    return Executable(checkpoint, config, wrapped)


def smoothing_to_try(config: Any, fps: float | None) -> int:
    """The odd number of control steps within a tenth of a second; 1 if predictions lie apart already.

    Args:
        config: the policy's, or a wrapper's.
        fps: control steps per second; None, not known, is taken as `PRESETS_FPS`.
    """
    predicting = getattr(config, "inner_config", config)
    if getattr(predicting, "chunk_stride", 1) > 1:
        return 1
    within = spaced_stride(fps or PRESETS_FPS)
    return within - 1 + within % 2


def execute(policy: LoadedPolicy, values: Iterable[tuple[str, Any]]) -> None:
    """Let a loaded policy act with these values of its configuration from its next ``reset`` on."""
    for name, value in values:
        setattr(policy.policy.config, name, value)


def executable_digest(executable: Executable) -> str:
    """What tells this checkpoint from all others, however it is executed."""
    return checkpoint_digest(executable.checkpoint, without=(*FIELDS, STEPS, "replan_s"))


def predicting(config: Any) -> Any:
    """The configuration of the policy that predicts: a wrapper's is its inner one."""
    return getattr(config, "inner_config", config)


def draws_noise(config: Any) -> bool:
    """Whether a policy with this configuration draws anything while it acts."""
    own = predicting(config)
    if own.type == "vqbet_chunked":
        return own.bet_softmax_temperature > 0
    return own.is_stochastic if hasattr(own, "is_stochastic") else own.type not in DETERMINISTIC


def denoises(config: Any) -> bool:
    """Whether acting reads the number of denoising steps from the configuration; LeRobot's do not."""
    own = isinstance(config, ChunkedConfig) and STEPS in {each.name for each in fields(config)}
    return own and getattr(config, STEPS) is not None


def changed(config: Any, values: dict[str, Any]) -> Any:
    """The configuration with these values, checked as on construction.

    Raises:
        ConfigurationError: they cannot work.
    """
    if isinstance(config, ChunkedConfig):
        return config.variant(**values, replan_s=None)
    return replace(config, **values)


def _own_execution(config: Any, checkpoint: str) -> dict[str, Any]:
    """How LeRobot's policies execute their chunks themselves, in the wrapper's words."""
    coeff = getattr(config, "temporal_ensemble_coeff", None)
    if coeff is not None:
        weighting = "act" if coeff >= 0 else "recency"
        return {
            "execution": "ensemble",
            "replan_interval": 1,
            "temporal_ensemble_coeff": abs(coeff),
            "ensemble_weighting": weighting,
        }
    used = getattr(config, "n_action_steps", None)
    if used is not None and used < 1:
        raise ConfigurationError(f"{checkpoint}: n_action_steps={used} executes nothing: set 1 or more")
    return {"execution": "open_loop", "n_action_steps": used}
