"""Settings of `temporal_ensemble`."""

import copy
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import draccus
from lerobot.configs import NormalizationMode, PreTrainedConfig
from lerobot.optim import LRSchedulerConfig, OptimizerConfig

from act_chunking_runtime.settings import ExecutionSettings, Mode
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.backbone_choice import choose_backbone
from lerobot_act_chunking.policies.chunk_length import chunk_length
from lerobot_act_chunking.policies.chunked_config import ChunkedConfig
from lerobot_act_chunking.policies.dataset_defaults import fit_to_dataset
from lerobot_act_chunking.policies.execution_fields import ExecutionFields, check_gripper_dims
from lerobot_act_chunking.policies.field_checks import check_fields
from lerobot_act_chunking.policies.limit_fields import LimitFields
from lerobot_act_chunking.policies.push_check import ChecksPush
from lerobot_act_chunking.policies.temporal_ensemble.inner import (
    DETERMINISTIC,
    decode_inner,
    read_inner,
)
from lerobot_act_chunking.policies.trained_on import RemembersTraining


@PreTrainedConfig.register_subclass("temporal_ensemble")
@dataclass
class TemporalEnsembleConfig(ExecutionFields, LimitFields, RemembersTraining, ChecksPush):
    """Chunk execution over another policy, the inner one: everything but execution is the inner policy's.

    Name the inner policy by ``inner_path`` or describe it by ``inner``. On construction both become the full
    ``inner`` with, for an ``inner_path``, its ``pretrained_path``: where a wrapper that is built afresh takes
    weights and processors from. Saved wrappers hold both themselves and need no path.

    Attributes:
        inner_path: checkpoint folder or repo id of the inner policy.
        inner: the inner policy's ``type`` and any of its settings, as in ``{type: act, chunk_size: 50}``.
        n_obs_steps: number of observations that the inner policy reads; one of its own settings.
        n_action_steps: how many of a chunk's first actions may be used [control steps]; by default all.
        execution: how chunks become actions, a mode of `ExecutionSettings`.

    Raises:
        ConfigurationError: on construction, naming the setting that cannot work.
    """

    inner_path: str | None = None
    # Not typed as PreTrainedConfig: draccus would expand the registry within itself for ever.
    inner: dict[str, Any] | None = None
    n_obs_steps: int = None  # pyright: ignore[reportAssignmentType]  (the inner policy's, on construction)
    n_action_steps: int | None = None
    execution: Mode = "ensemble"

    def __post_init__(self) -> None:
        check_fields(self)
        if (self.inner is None) == (self.inner_path is None):
            raise ConfigurationError(
                "temporal_ensemble wraps another policy: set either --policy.inner_path=<checkpoint> or "
                "--policy.inner='{type: ...}'" + (", not both" if self.inner else "")
            )
        settings = self.inner if self.inner_path is None else read_inner(self.inner_path)
        assert settings is not None  # noqa: S101 (checked above)
        self.device = self.device or settings.get("device")
        if self.inner_path is not None:
            self.use_amp = self.use_amp or settings.get("use_amp", False)
        super().__post_init__()
        # The wrapper pushes, if anyone does.
        self._inner_config = decode_inner(settings, device=self.device, push_to_hub=False, repo_id=None)
        self.input_features = self.input_features or self._inner_config.input_features
        self.output_features = self.output_features or self._inner_config.output_features
        self.trained_on = self.trained_on or getattr(self._inner_config, "trained_on", None)
        self._adopt_limits()
        self._adopt_observation_steps()
        self.inner, self.inner_path = self._encoded(self.inner_config), None
        self._check_execution()

    def _adopt_limits(self) -> None:
        """Keep to the limits of the inner policy, which executes nothing itself, unless others are given."""
        names = [each.name for each in fields(LimitFields)]
        inner = self._inner_config
        if isinstance(inner, LimitFields) and all(getattr(self, name) in ("none", None) for name in names):
            for name in names:
                setattr(self, name, getattr(inner, name))
        self.check_limits()

    def _adopt_observation_steps(self) -> None:
        inner, steps = self._inner_config.type, self._inner_config.n_obs_steps
        if self.n_obs_steps not in (None, steps):
            raise ConfigurationError(
                f"n_obs_steps={self.n_obs_steps}: the inner {inner} observes {steps} steps; that is one of "
                "its own settings"
            )
        self.n_obs_steps = steps

    def _check_execution(self) -> None:
        settings, inner = self.execution_settings, self._inner_config.type
        if settings.execution == "coherence" and inner in DETERMINISTIC:
            raise ConfigurationError(
                f"execution=coherence chooses among sampled chunks, but the inner {inner} always predicts "
                "the same one: choose another mode"
            )

    @staticmethod
    def _encoded(inner: PreTrainedConfig) -> dict[str, Any]:
        return draccus.encode(inner, PreTrainedConfig)  # pyright: ignore[reportReturnType]

    @property
    def inner_config(self) -> PreTrainedConfig:
        """The inner policy's configuration, with the features that LeRobot filled in here."""
        inner = self._inner_config
        inner.input_features, inner.output_features = self.input_features, self.output_features
        inner.device = self.device
        return inner

    def fit_to_dataset(self, meta: Any) -> None:
        """Let the chunks of an inner policy of this package follow from the dataset, as far as nobody chose.

        Args:
            meta: LeRobot's metadata of the dataset.
        """
        inner = self.inner_config
        if isinstance(inner, ChunkedConfig):
            fit_to_dataset(
                inner, meta, lambda each: self.resolve_execution(chunk_length(each), self.n_action_steps)
            )
            inner.settle(**{inner.length_name: getattr(inner, inner.length_name)})  # it must not choose again
            self.inner = self._encoded(inner)

    def choose_backbone(self) -> None:
        """Decide what ``pretrained_backbone_weights=auto`` of an inner policy of this package stands for."""
        inner = self.inner_config
        if isinstance(inner, ChunkedConfig):
            choose_backbone(inner)
            self.inner = self._encoded(inner)

    @property
    def inner_source(self) -> str | None:
        """Where a wrapper that is built afresh takes the inner weights and processors from, if anywhere."""
        path = self._inner_config.pretrained_path
        return None if path is None else str(path)

    @property
    def chunk_size(self) -> int:
        """How many control steps the inner policy's longest chunk covers."""
        return chunk_length(self._inner_config)

    @property
    def execution_settings(self) -> ExecutionSettings:
        """How chunks are executed, with the mode's defaults filled in."""
        return self.resolve_execution(self.chunk_size, self.n_action_steps, self.action_feature)

    def __getattr__(self, name: str) -> Any:
        """Optional settings that LeRobot looks for, such as ``drop_n_last_frames`` and ``dtype``."""
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.inner_config, name)

    def _save_pretrained(self, save_directory: Path) -> None:
        saved = copy.copy(self)
        saved.inner = {**self._encoded(self.inner_config), "pretrained_path": None}
        PreTrainedConfig._save_pretrained(saved, save_directory)

    def validate_features(self) -> None:
        """Check the inputs and outputs as the inner policy does, and which of them are grippers."""
        self.inner_config.validate_features()
        check_gripper_dims(self.gripper_dims, self.action_feature)

    def training_optimizer(self) -> OptimizerConfig:
        """The inner policy's."""
        return self.inner_config.get_optimizer_preset()

    def get_scheduler_preset(self) -> LRSchedulerConfig | None:
        """The inner policy's."""
        return self.inner_config.get_scheduler_preset()

    @property
    def normalization_mapping(self) -> dict[str, NormalizationMode]:
        """The inner policy's."""
        return self._inner_config.normalization_mapping  # pyright: ignore[reportAttributeAccessIssue]

    @property
    def observation_delta_indices(self) -> list[int] | None:
        """Steps of the observations LeRobot loads for the inner policy."""
        return self._inner_config.observation_delta_indices

    @property
    def action_delta_indices(self) -> list[int] | None:
        """Steps of the actions LeRobot loads for the inner policy."""
        return self._inner_config.action_delta_indices

    @property
    def reward_delta_indices(self) -> list[int] | None:
        """Steps of the rewards LeRobot loads for the inner policy."""
        return self._inner_config.reward_delta_indices
