"""Settings of `act_chunked`."""

from dataclasses import dataclass
from typing import Any, Literal, get_args, get_origin, get_type_hints

from lerobot.configs import FeatureType, NormalizationMode, PreTrainedConfig
from lerobot.optim import AdamWConfig, LRSchedulerConfig
from lerobot.optim.schedulers import (
    ConstantWithWarmupSchedulerConfig,
    CosineAnnealingWithWarmupSchedulerConfig,
)
from lerobot.utils.constants import ACTION, OBS_STATE

from lerobot_act_chunking.data.batch import FeatureSpec
from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.errors import ConfigurationError, FeatureError, unknown_choice
from lerobot_act_chunking.execution.settings import ExecutionSettings, Mode
from lerobot_act_chunking.hub.preflight import check_push
from lerobot_act_chunking.policies.act_chunked.presets import preset_values
from lerobot_act_chunking.policies.execution_fields import ExecutionFields

PRESET: Any = None  # default of every field that the preset decides


@PreTrainedConfig.register_subclass("act_chunked")
@dataclass
class ActChunkedConfig(ExecutionFields, PreTrainedConfig):
    """Settings of `act_chunked`, under LeRobot's ACT names where both have them.

    Inputs may be any mix of ``observation.state``, further state vectors, ``observation.environment_state``
    and cameras of any shapes; at least one of them. Fields whose default is the preset's are resolved on
    construction: a saved config holds plain values, and a value given explicitly wins over the preset.

    Attributes:
        preset: ``base`` (ours) or ``paper`` (LeRobot's ACT, with its normalisation and its optimiser).
            Pretrained backbone weights are the exception: neither preset asks for them.
        n_obs_steps: observation steps; only 1 so far.
        chunk_size: predicted actions per chunk.
        chunk_stride: control steps between two predicted actions; what lies between is interpolated, so that
            a chunk of few actions covers seconds.
        n_action_steps: how many of a chunk's first actions may be executed [control steps]; by default all.
        execution: how chunks become actions; this and the other fields of execution (``replan_interval``,
            ``latency_steps``, ``temporal_ensemble_coeff``, ...) are those of `ExecutionSettings`. ``base``
            replans four times a chunk and blends each new one in, ``paper`` runs each chunk to its end, as
            LeRobot does.
        actions_per_query: consecutive actions that each decoder query emits; divides ``chunk_size``. 1 is
            ACT; more makes long chunks cheap.
        normalization_mapping: how each type of feature is normalised; types not named keep the preset's
            normalisation. LeRobot's ACT leaves the environment state as it is.
        norm_std_floor: least spread that normalisation divides by, in raw units (0 = none).
        vision_backbone: a torchvision ResNet, or ``small_cnn`` for small images on a CPU.
        pretrained_backbone_weights: torchvision weights such as ``ResNet18_Weights.IMAGENET1K_V1``. They
            must be in torch hub's cache; nothing is downloaded.
        backbone_norm: normalisation layers of a ResNet. Pretrained weights need ``frozen_batch``; without
            them it amounts to no normalisation at all.
        pre_norm: normalise before each transformer branch instead of after it.
        dim_model: token width, a multiple of 4 and of ``n_heads``.
        n_heads: attention heads.
        dim_feedforward: hidden width of the feed-forward branches.
        feedforward_activation: their activation.
        n_encoder_layers: encoder layers.
        n_decoder_layers: decoder layers; action queries interact from the second on.
        dropout: dropout probability everywhere in the transformers.
        use_vae: learn a latent style of each demonstration (zero when acting).
        latent_dim: its size.
        n_vae_encoder_layers: layers of its encoder.
        kl_weight: weight of its KL divergence [nats, summed over dimensions] beside the mean absolute error.
        pad_normalization: average the action error over ``valid`` elements (LeRobot) or ``all`` (original
            ACT).
        use_ema: act with an exponential moving average of the weights.
        ema_power: the average's decay after n updates is ``1 - n ** -ema_power`` ...
        ema_max_value: ... up to this; use 0.999 for runs under 10 000 steps.
        optimizer_lr: AdamW learning rate.
        optimizer_lr_backbone: the same for the image backbone.
        optimizer_weight_decay: AdamW weight decay.
        optimizer_betas: AdamW moment decays.
        lr_schedule: ``constant``, or ``cosine`` to zero over the run, both after the warm-up.
        lr_warmup_steps: linear warm-up [optimiser steps].

    Raises:
        ConfigurationError: on construction, naming the setting that cannot work.
    """

    preset: Literal["base", "paper"] = "base"

    n_obs_steps: int = 1
    chunk_size: int = 100
    chunk_stride: int = 1
    n_action_steps: int = PRESET
    actions_per_query: int = 1
    execution: Mode = PRESET

    normalization_mapping: dict[str, NormalizationMode] = PRESET
    norm_std_floor: float = PRESET

    vision_backbone: Literal["small_cnn", "resnet18", "resnet34", "resnet50"] = "resnet18"
    pretrained_backbone_weights: str | None = None
    backbone_norm: Literal["group", "frozen_batch"] = PRESET

    pre_norm: bool = PRESET
    dim_model: int = PRESET
    n_heads: int = 8
    dim_feedforward: int = PRESET
    feedforward_activation: Literal["relu", "gelu"] = PRESET
    n_encoder_layers: int = 4
    n_decoder_layers: int = 1
    dropout: float = 0.1

    use_vae: bool = PRESET
    latent_dim: int = 32
    n_vae_encoder_layers: int = 4
    kl_weight: float = 10.0

    pad_normalization: Literal["valid", "all"] = "valid"

    use_ema: bool = False
    ema_power: float = 0.75
    ema_max_value: float = 0.9999

    optimizer_lr: float = PRESET
    optimizer_lr_backbone: float = 1e-5
    optimizer_weight_decay: float = 1e-4
    optimizer_betas: tuple[float, float] = PRESET
    lr_schedule: Literal["constant", "cosine"] = PRESET
    lr_warmup_steps: int = PRESET

    def __post_init__(self) -> None:
        super().__post_init__()
        self._resolve_preset()
        self._check_choices()
        self._check()

    def _check_choices(self) -> None:
        for name, hint in get_type_hints(type(self)).items():
            if get_origin(hint) is Literal and getattr(self, name) not in get_args(hint):
                raise unknown_choice(name, getattr(self, name), get_args(hint))

    def _resolve_preset(self) -> None:
        pretrained = self.pretrained_backbone_weights is not None
        values = preset_values(self.preset, dim_model=self.dim_model, pretrained=pretrained)
        values["n_action_steps"] = self.timing.control_steps
        if (self.n_action_steps or self.timing.control_steps) == 1:
            values["execution"] = "open_loop"
        self.normalization_mapping = values["normalization_mapping"] | (self.normalization_mapping or {})
        for name, value in values.items():
            if getattr(self, name) is PRESET:
                setattr(self, name, value)

    def _check(self) -> None:
        settings = self.execution_settings
        if settings.execution == "coherence":
            raise ConfigurationError(
                "execution=coherence chooses among sampled chunks, but act_chunked predicts a single one"
            )
        if self.n_obs_steps != 1:
            raise ConfigurationError(
                f"n_obs_steps={self.n_obs_steps}: act_chunked reads one observation step"
            )
        for count, divisor in (
            ("chunk_size", "actions_per_query"),
            ("dim_model", "n_heads"),
        ):
            self._check_divides(count, divisor)
        if self.dim_model % 4:
            raise ConfigurationError(f"dim_model={self.dim_model} must be a multiple of 4 (image positions)")
        if self.pretrained_backbone_weights is not None and self.backbone_norm != "frozen_batch":
            raise ConfigurationError(
                f"pretrained weights need backbone_norm=frozen_batch, not {self.backbone_norm}"
            )
        self._check_ranges()

    def _check_divides(self, count: str, divisor: str) -> None:
        n, d = getattr(self, count), getattr(self, divisor)
        if d < 1 or n % d:
            raise ConfigurationError(f"{count}={n} must be divisible by {divisor}={d}")

    def _check_ranges(self) -> None:
        for name in ("n_encoder_layers", "n_decoder_layers", "n_vae_encoder_layers", "latent_dim"):
            if getattr(self, name) < 1:
                raise ConfigurationError(f"{name}={getattr(self, name)} must be at least 1")
        for name in ("dropout", "ema_max_value"):
            if not 0 <= getattr(self, name) < 1:
                raise ConfigurationError(f"{name}={getattr(self, name)} must be at least 0 and below 1")
        for name in ("norm_std_floor", "kl_weight", "ema_power"):
            if not getattr(self, name) >= 0:
                raise ConfigurationError(f"{name}={getattr(self, name)} must not be negative")

    @property
    def timing(self) -> ChunkTiming:
        """Which steps are observed and predicted."""
        return ChunkTiming(self.n_obs_steps, self.chunk_size, self.chunk_stride)

    @property
    def execution_settings(self) -> ExecutionSettings:
        """How chunks are executed, with the mode's defaults filled in."""
        return self.resolve_execution(self.timing.control_steps, self.n_action_steps)

    @property
    def feature_spec(self) -> FeatureSpec:
        """What the policy reads from a batch; ``observation.state`` first, the environment state last."""
        inputs = self.input_features or {}
        order = {FeatureType.STATE: 0, FeatureType.ENV: 1}
        vectors = sorted(
            (key for key, feature in inputs.items() if feature.type in order),
            key=lambda key: (order[inputs[key].type], key != OBS_STATE, key),
        )
        if self.action_feature is None:
            raise FeatureError(f"the policy needs an output feature {ACTION!r}")
        return FeatureSpec(
            vectors={key: tuple(inputs[key].shape) for key in vectors},
            images={key: tuple(feature.shape) for key, feature in self.image_features.items()},
            action=tuple(self.action_feature.shape),
        )

    def validate_features(self) -> None:
        """Check the inputs and outputs that LeRobot filled in from the dataset or the environment.

        Raises:
            FeatureError: naming what is missing or has an unusable shape.
        """
        spec = self.feature_spec
        if not spec.vectors and not spec.images:
            raise FeatureError(
                "the policy needs at least one state vector or camera among its input features"
            )
        for key, shape in {**spec.vectors, ACTION: spec.action}.items():
            if len(shape) != 1:
                raise FeatureError(f"{key!r} must be a vector, but its shape is {shape}")
        for key, shape in spec.images.items():
            if len(shape) != 3 or shape[0] != 3:
                raise FeatureError(
                    f"{key!r} must be an image of shape (3, height, width), but its shape is {shape}"
                )

    def get_optimizer_preset(self) -> AdamWConfig:
        """AdamW with LeRobot's gradient clipping at norm 10.

        LeRobot asks for it when a fresh run starts, and only then; so this is also where a run whose push at
        the end cannot succeed is refused.

        Raises:
            ConfigurationError: naming the ways out, if the run would push and nothing could take the push.
        """
        check_push(self)
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
