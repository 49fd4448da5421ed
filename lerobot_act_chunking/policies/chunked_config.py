"""What the configurations of this package's policies have in common."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from lerobot.configs import FeatureType, NormalizationMode
from lerobot.optim import AdamWConfig, LRSchedulerConfig
from lerobot.optim.schedulers import (
    ConstantWithWarmupSchedulerConfig,
    CosineAnnealingWithWarmupSchedulerConfig,
)
from lerobot.utils.constants import ACTION, OBS_STATE

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.data.batch import FeatureSpec
from lerobot_act_chunking.data.episode_modes import require_recorded_modes
from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.errors import ConfigurationError, FeatureError
from lerobot_act_chunking.policies.camera_fields import RANDOM_BACKBONE, CameraFields
from lerobot_act_chunking.policies.dataset_reading import DatasetReading, Features
from lerobot_act_chunking.policies.execution_fields import ExecutionFields, check_gripper_dims
from lerobot_act_chunking.policies.field_checks import check_fields
from lerobot_act_chunking.policies.given_settings import GivenSettings
from lerobot_act_chunking.policies.language.fields import LanguageFields, tasks_of
from lerobot_act_chunking.policies.limit_fields import LimitFields
from lerobot_act_chunking.policies.push_check import ChecksPush
from lerobot_act_chunking.policies.seconds import to_chunk_size, to_interval, to_stride
from lerobot_act_chunking.policies.trained_on import RemembersTraining

PRESET: Any = None  # default of every field that is decided on construction
PRETRAINED_LR = 1e-5  # ACT's learning rate of pretrained backbones
IN_SECONDS = ("prediction_dt", "horizon_s", "replan_s")


@dataclass
class ChunkedConfig(
    DatasetReading,
    ExecutionFields,
    LimitFields,
    CameraFields,
    LanguageFields,
    RemembersTraining,
    GivenSettings,
    ChecksPush,
):
    """Settings of every policy that predicts chunks from any mix of state vectors, cameras and instructions.

    Lengths may be given in seconds instead of control steps. A configuration cannot see the dataset, so
    ``fps`` is then needed, too; a dataset recorded at another rate is refused.

    Attributes:
        state_keys: state vectors to read (features of type STATE); by default all of them.
        fps: control steps per second; only needed for lengths in seconds.
        horizon_s: time that a chunk covers [s], in place of ``chunk_size`` (``horizon``).
        prediction_dt: time between two predicted actions [s], in place of ``chunk_stride``.
        replan_s: time from one chunk to the next [s], in place of ``replan_interval``.
        chunk_stride: control steps between two predicted actions; what lies between is interpolated, so that
            a chunk of few actions covers seconds. Where neither it nor the chunk's length is given, training
            with ``preset=base`` lays predictions a tenth of a second apart, if actions are positions.
        n_action_steps: how many of a chunk's first actions may be executed [control steps]; by default all.
        normalization_mapping: how each type of feature is normalised; types not named keep the default.
        norm_std_floor: least spread that normalisation divides by, in raw units (0 = none).
        use_ema: act with an exponential moving average of the weights.
        ema_power: the decay of the moving average after n updates is ``1 - n ** -ema_power``.
        ema_max_value: largest decay of the moving average; use 0.999 for runs under 10 000 steps.
        optimizer_lr: AdamW learning rate.
        optimizer_lr_backbone: AdamW learning rate of the image backbone; by default 1e-5 if it is pretrained,
            and ``optimizer_lr`` if it starts from scratch.
        optimizer_weight_decay: AdamW weight decay.
        optimizer_betas: AdamW moment decays.
        lr_schedule: ``constant``, or ``cosine`` to zero over the run, both after the warm-up.
        lr_warmup_steps: linear warm-up [optimiser steps].
        balance_modes: let rare ways of doing the task count more in training: ``labels`` as recorded
            (``act-chunking record``), ``clusters`` of the demonstrated motions, or ``none``.
        mode_balance_power: weights are (1 / a way's share of the samples) to this power: 1 gives all ways
            the same part in the loss, 0.5 the square root of that.
    """

    # Choices of fields that LeRobot's policies have, too: its command line has one argument for all fields of
    # a name, so that a Literal or `one_of` here would refuse what another policy takes.
    choices: ClassVar[dict[str, tuple[str, ...]]] = {}
    # The names that ``preset`` may have; the settings' reference shows a column for each.
    presets: ClassVar[tuple[str, ...]]
    # Those whose predictions training lays a tenth of a second apart.
    spaced_presets: ClassVar[tuple[str, ...]] = ("base",)

    state_keys: list[str] | None = None

    fps: float | None = None
    horizon_s: float | None = None
    prediction_dt: float | None = None
    replan_s: float | None = None

    chunk_stride: int = PRESET
    n_action_steps: int = PRESET

    normalization_mapping: dict[str, NormalizationMode] = PRESET
    norm_std_floor: float = PRESET

    use_ema: bool = False
    ema_power: float = 0.75
    ema_max_value: float = 0.9999

    optimizer_lr: float = PRESET
    optimizer_lr_backbone: float = PRESET
    optimizer_weight_decay: float = 1e-4
    optimizer_betas: tuple[float, float] = PRESET
    lr_schedule: Literal["constant", "cosine"] = PRESET
    lr_warmup_steps: int = PRESET

    balance_modes: Literal["none", "labels", "clusters"] = "none"
    mode_balance_power: float = 1.0

    def __post_init__(self) -> None:
        check_fields(self)
        self.check_limits()
        self.check_language()
        super().__post_init__()

    @property
    def length_name(self) -> str:
        """The field that says how many actions are predicted."""
        return "chunk_size"

    @property
    def timing(self) -> ChunkTiming:
        """Which steps are observed and predicted."""
        raise NotImplementedError

    @property
    def execution_settings(self) -> ExecutionSettings:
        """How chunks are executed, with the mode's defaults filled in."""
        return self.resolve_execution(self.timing.control_steps, self.n_action_steps, self.action_feature)

    def fill_in(self, values: dict[str, Any]) -> None:
        """Set every field that was not given to its value here; given normalisations win one by one.

        Of a chunk all actions may be executed. A single one leaves nothing to blend: it is executed as it is.
        """
        given = {key: NormalizationMode(mode) for key, mode in (self.normalization_mapping or {}).items()}
        self.normalization_mapping = values["normalization_mapping"] | given
        for name, value in ({"chunk_stride": 1} | RANDOM_BACKBONE | values).items():
            if getattr(self, name) is PRESET:
                setattr(self, name, value)
        if self.n_action_steps is PRESET:
            self.n_action_steps = self.timing.control_steps
        if self.n_action_steps == 1 and self.given("execution") is PRESET:
            self.execution = "open_loop"
        if self.optimizer_lr_backbone is PRESET:
            self.optimizer_lr_backbone = PRETRAINED_LR if self.starts_pretrained else self.optimizer_lr

    def resolve_seconds(self, past_steps: int = 0) -> None:
        """Turn lengths in seconds into control steps. Comes before `fill_in`: what they decide is given.

        Args:
            past_steps: predictions before the current step, which the chunk's field counts, too.

        Raises:
            ConfigurationError: without ``fps``, or if both forms are given and differ.
        """
        given = [name for name in IN_SECONDS if getattr(self, name) is not None]
        if not given:
            return
        if self.fps is None:
            raise ConfigurationError(
                f"{given[0]}={getattr(self, given[0])} s needs the control rate: set --policy.fps to the "
                "dataset's frames per second"
            )
        if self.prediction_dt is not None:
            self._take("chunk_stride", to_stride(self.prediction_dt, self.fps), "prediction_dt")
        if self.horizon_s is not None:
            n_predictions = to_chunk_size(self.horizon_s, self.fps, self.chunk_stride or 1)
            self._take(self.length_name, n_predictions + past_steps, "horizon_s")
        if self.replan_s is not None:
            self._take("replan_interval", to_interval(self.replan_s, self.fps), "replan_s")

    def _take(self, name: str, value: int, seconds: str) -> None:
        given = getattr(self, name)
        if given is not None and given != value:
            raise ConfigurationError(
                f"{seconds}={getattr(self, seconds)} s at fps={self.fps:g} makes {name}={value}, but {name}="
                f"{given} is given, too: leave one of them out (--policy.{seconds}=null)"
            )
        setattr(self, name, value)

    def check_fps(self, fps: float) -> None:
        """Refuse a dataset whose rate is not the one that lengths in seconds were resolved for.

        Raises:
            ConfigurationError: naming both.
        """
        if self.fps is not None and self.fps != fps:
            raise ConfigurationError(
                f"fps={self.fps:g}, but the dataset was recorded at {fps:g} Hz: set --policy.fps={fps:g}"
            )

    def check_dataset(self, features: Features, meta: Any) -> None:
        """Refuse a dataset that the policy cannot learn from, or whose modes are asked for and not known."""
        super().check_dataset(features, meta)
        if self.balance_modes == "labels":
            require_recorded_modes(Path(meta.root))
        if self.language_encoder is not None:
            tasks_of(meta)

    @property
    def feature_spec(self) -> FeatureSpec:
        """What the policy reads from a batch; ``observation.state`` first, the environment state last."""
        inputs = self.input_features or {}
        order = {FeatureType.STATE: 0, FeatureType.ENV: 1}
        vectors = sorted(
            (key for key, feature in inputs.items() if feature.type in order and self.reads(key, feature)),
            key=lambda key: (order[inputs[key].type], key != OBS_STATE, key),
        )
        if self.action_feature is None:
            raise FeatureError(f"the policy needs an output feature {ACTION!r}")
        return FeatureSpec(
            vectors={key: tuple(inputs[key].shape) for key in vectors},
            images={key: tuple(feature.shape) for key, feature in self.image_features.items()},
            action=tuple(self.action_feature.shape),
            view=self.image_view,
        )

    def validate_features(self) -> None:
        """Check the inputs and outputs that LeRobot filled in from the dataset or the environment.

        Raises:
            FeatureError: naming what is missing or has an unusable shape.
            ConfigurationError: if ``gripper_dims`` names dimensions that the action has not, or
                ``crop_shape`` is larger than images.
        """
        self._check_state_keys()
        spec = self.feature_spec
        if not spec.vectors and not spec.images:
            raise FeatureError(
                "the policy needs at least one state vector or camera among its input features"
            )
        for key, shape in {**spec.vectors, ACTION: spec.action}.items():
            if len(shape) != 1 or shape[0] < 1:
                raise FeatureError(f"{key!r} must be a vector of one value or more, but its shape is {shape}")
        for key, shape in spec.images.items():
            if len(shape) != 3 or shape[0] != 3 or min(shape) < 1:
                raise FeatureError(
                    f"{key!r} must be an image of shape (3, height, width), but its shape is {shape}"
                )
        self.check_views(spec.images)
        check_gripper_dims(self.gripper_dims, self.action_feature)

    def _check_state_keys(self) -> None:
        inputs = self.input_features or {}
        states = sorted(key for key, feature in inputs.items() if feature.type is FeatureType.STATE)
        for key in self.state_keys or ():
            if key not in states:
                raise FeatureError(
                    f"state_keys names {key!r}, but the state vectors are: {', '.join(states) or 'none'}"
                )

    def training_optimizer(self) -> AdamWConfig:
        """AdamW with LeRobot's gradient clipping at norm 10."""
        return AdamWConfig(
            lr=self.optimizer_lr, betas=self.optimizer_betas, weight_decay=self.optimizer_weight_decay
        )

    def get_scheduler_preset(self) -> LRSchedulerConfig | None:
        """The learning-rate schedule over the whole run; None if the rate never changes."""
        if self.lr_schedule == "cosine":
            return CosineAnnealingWithWarmupSchedulerConfig(self.lr_warmup_steps)
        return ConstantWithWarmupSchedulerConfig(self.lr_warmup_steps) if self.lr_warmup_steps else None

    @property
    def observation_delta_indices(self) -> list[int] | None:
        """Steps of the observations LeRobot loads."""
        return self.timing.observation_deltas

    @property
    def action_delta_indices(self) -> list[int]:
        """Steps of the actions LeRobot loads."""
        return self.timing.action_deltas

    @property
    def reward_delta_indices(self) -> None:
        """No rewards."""
        return
