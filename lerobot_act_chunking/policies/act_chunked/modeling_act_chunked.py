"""The `act_chunked` policy: ACT's wiring of the package's blocks into LeRobot's contract."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, Self

import torch
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import OBS_STATE
from torch import Tensor

from lerobot_act_chunking.data.batch import ActionTarget, Observation, first_non_finite
from lerobot_act_chunking.data.masking import per_sample_error
from lerobot_act_chunking.errors import ConfigurationError, DatasetError
from lerobot_act_chunking.execution.executor import ChunkExecutor
from lerobot_act_chunking.execution.interpolation import upsample
from lerobot_act_chunking.execution.timeline import Environments
from lerobot_act_chunking.heads.regression import RegressionHead
from lerobot_act_chunking.hub.card import extend_card
from lerobot_act_chunking.nn.ema import WeightAverage
from lerobot_act_chunking.nn.observation import CameraTokens, ObservationEncoder, VectorTokens
from lerobot_act_chunking.nn.style import StyleEncoder, kl_to_standard_normal, sample_latent
from lerobot_act_chunking.nn.transformer import Decoder, Encoder, LayerSpec
from lerobot_act_chunking.nn.vision import make_backbone
from lerobot_act_chunking.policies.act_chunked.configuration_act_chunked import ActChunkedConfig
from lerobot_act_chunking.policies.act_chunked.network import ActNetwork
from lerobot_act_chunking.policies.statistics import check_finite

FUSED_ADAMW_DEVICES = ("cpu", "cuda", "mps")

Batch = dict[str, Any]


class ActChunkedPolicy(PreTrainedPolicy):
    """Action Chunking with Transformers (Zhao et al. 2023) over any mix of state vectors and cameras.

    Batches are LeRobot's: normalised, on the policy's device. None is ever changed.
    """

    config_class = ActChunkedConfig  # pyright: ignore[reportAssignmentType]  (LeRobot declares None)
    name = "act_chunked"  # pyright: ignore[reportAssignmentType]
    _fsdp_wrap_modules = ["EncoderLayer", "DecoderLayer"]  # noqa: RUF012 (LeRobot's declaration of its type)

    def __init__(
        self,
        config: ActChunkedConfig,
        *,
        dataset_stats: dict[str, dict[str, Any]] | None = None,
        dataset_meta: Any | None = None,
        load_backbone_weights: bool = True,
        **_: Any,
    ):
        """Build the policy.

        Args:
            config: its settings, with input and output features.
            dataset_stats: statistics of the training data, checked if given.
            dataset_meta: LeRobot's metadata of the training data, checked if given.
            load_backbone_weights: fill in ``pretrained_backbone_weights``; not if a checkpoint follows.

        Raises:
            FeatureError: if inputs or outputs cannot work.
            ConfigurationError: if no episode is as long as a chunk, or pretrained weights are not cached.
            DatasetError: if the statistics are not finite.
        """
        super().__init__(config)
        config.validate_features()
        if dataset_meta is not None and dataset_meta.episodes is not None:
            config.timing.check_episode_length(max(dataset_meta.episodes["length"]))
        if dataset_stats is not None:
            check_finite(config, dataset_stats)
        self.config = config
        self.feature_spec = config.feature_spec
        weights = config.pretrained_backbone_weights if load_backbone_weights else None
        self.model = build_network(config, weights)
        self.ema = (
            WeightAverage(self.model, power=config.ema_power, max_value=config.ema_max_value)
            if config.use_ema
            else None
        )
        self.register_load_state_dict_post_hook(_adopt_average)
        self.reset()

    @classmethod
    def from_pretrained(cls, pretrained_name_or_path: str | Path, **kwargs: Any) -> Self:
        """Load a checkpoint, as LeRobot, but refuse one that does not fit in place of loading it in part.

        Backbone weights come from the checkpoint, not from torch hub's cache.
        """
        kwargs = {"strict": True, "load_backbone_weights": False, **kwargs}
        return super().from_pretrained(pretrained_name_or_path, **kwargs)

    def forward(
        self, batch: Batch, reduction: Literal["mean", "none"] = "mean"
    ) -> tuple[Tensor, dict[str, float]]:
        """Training loss: masked absolute error, plus the weighted KL divergence with a VAE in training mode.

        Args:
            batch: observations, ``action`` (B, T, A) and ``action_is_pad`` (B, T).
            reduction: ``mean`` for a scalar; ``none`` for one loss per sample (B,), with the same mean.

        Returns:
            The loss, and ``l1_loss`` and (with KL) ``kld_loss`` as plain numbers.

        Raises:
            FeatureError: naming a key that is missing or has another shape than the policy was built for.
            DatasetError: if the loss is not finite, naming the first key that holds a NaN or an infinity.
        """
        observation = Observation.from_lerobot(batch, self.feature_spec)
        target = ActionTarget.from_lerobot(batch, self.feature_spec, self.config.chunk_size)
        style, divergence = self._encode_style(observation, target)
        error = self.model.head.error(self._network(observation, style), target.actions)
        loss = l1 = per_sample_error(error, target.is_pad, self.config.pad_normalization)
        terms = {"l1_loss": l1.mean()}
        if divergence is not None:
            loss = l1 + self.config.kl_weight * divergence
            terms["kld_loss"] = divergence.mean()
        metrics = dict(zip(terms, torch.stack(list(terms.values())).tolist(), strict=True))
        if not all(map(math.isfinite, metrics.values())):
            raise not_finite(batch, metrics)
        return (loss.mean() if reduction == "mean" else loss), metrics

    def _encode_style(
        self, observation: Observation, target: ActionTarget
    ) -> tuple[Tensor, Tensor] | tuple[None, None]:
        """Embedding of a sampled latent, and its KL divergence; only in training, as in ACT."""
        encoder = self.model.style_encoder
        if encoder is None or not self.training:
            return None, None
        state = observation.vectors.get(OBS_STATE)
        mean, log_variance = encoder(target.actions, target.is_pad, state)
        latent = sample_latent(mean, log_variance, torch.randn_like(mean))
        return encoder.embed(latent), kl_to_standard_normal(mean, log_variance)

    @property
    def _network(self) -> ActNetwork:
        """The network in use: the averaged one when acting, if there is one."""
        return self.model if self.ema is None or self.training else self.ema.network

    @torch.no_grad()
    def predict_action_chunk(self, batch: Batch, **_: Any) -> Tensor:
        """The whole chunk of normalised actions (B, T, A), one per control step; needs no earlier call."""
        observation = Observation.from_lerobot(batch, self.feature_spec)
        return self._predict(observation, self.config.timing.control_steps)

    @torch.no_grad()
    def select_action(self, batch: Batch, **_: Any) -> Tensor:
        """The normalised action (B, A) of this control step. Call `reset` at the start of each rollout."""
        observation = Observation.from_lerobot(batch, self.feature_spec)

        def predict(envs: Environments) -> Tensor:
            needing = observation if envs is None else observation.select(envs)
            return self._predict(needing, self.config.n_action_steps)

        return self._action_queue.step(predict, observation.batch_size)

    def _predict(self, observation: Observation, n_steps: int) -> Tensor:
        if self.training:
            self.eval()
        config = self.config
        n_predictions = config.timing.predictions_for(n_steps)
        n_queries = math.ceil(n_predictions / config.actions_per_query)
        keyframes = self._network(observation, n_queries=n_queries)[:, :n_predictions]
        return upsample(keyframes, config.chunk_stride, config.gripper_dims)[:, :n_steps]

    def reset(self, envs: Sequence[int] | Tensor | None = None) -> None:
        """Forget all chunks: a new rollout begins, in all environments or in these alone."""
        if envs is None:  # anew, because evaluation may have changed the settings since
            # LeRobot and its tools look for a queue under this name to learn when the next inference is due.
            self._action_queue = ChunkExecutor(self.config.execution_settings)
        else:
            self._action_queue.reset(envs)

    def update(self) -> None:
        """Follow the weights with their average; LeRobot calls this after every optimiser step."""
        if self.ema is not None:
            self.ema.update(self.model)

    def get_optim_params(self) -> list[dict[str, Any]]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Parameter groups for the optimiser: the image backbone learns at its own rate.

        The groups ask for PyTorch's fused AdamW, which LeRobot's AdamWConfig cannot: the same update, faster.
        """
        cameras = self.model.observation_encoder.cameras
        backbone = [] if cameras is None else list(cameras.backbone.parameters())
        in_backbone = set(backbone)
        rest = [p for p in self.model.parameters() if p not in in_backbone]
        groups = [{"params": rest}, {"params": backbone, "lr": self.config.optimizer_lr_backbone}]
        fused = rest[0].device.type in FUSED_ADAMW_DEVICES
        return [{**group, "fused": fused} for group in groups if group["params"]]

    def generate_model_card(self, *args: Any, dataset_meta: Any | None = None, **kwargs: Any) -> Any:
        """LeRobot's model card, plus what this policy reads and how it acts."""
        card = super().generate_model_card(*args, dataset_meta=dataset_meta, **kwargs)
        return extend_card(card, self.config, fps=None if dataset_meta is None else dataset_meta.fps)

    def _get_default_peft_targets(self) -> dict[str, Any]:
        """Adapt all attention projections and feed-forward layers of the encoder and decoder."""
        return {
            "target_modules": r"model\.(encoder|decoder)\..*\.([qkv]_proj|out_proj|expand|contract)",
            "modules_to_save": ["head"],
        }

    def _validate_peft_config(self, peft_config: Any) -> None:
        super()._validate_peft_config(peft_config)
        if self.ema is not None:
            raise ConfigurationError("use_ema does not follow PEFT adapters: set --policy.use_ema=false")


def _adopt_average(policy: ActChunkedPolicy, incompatible: Any) -> None:
    """Let a checkpoint and the policy that loads it differ in `use_ema`.

    After weights without an average, one starts at them; an average that is not wanted is left behind.
    """
    without_average = [key for key in incompatible.missing_keys if not key.startswith("ema.")]
    if policy.ema is not None and len(without_average) < len(incompatible.missing_keys):
        policy.ema.restart(policy.model)
    incompatible.missing_keys[:] = without_average
    if policy.ema is None:
        unexpected = [key for key in incompatible.unexpected_keys if not key.startswith("ema.")]
        incompatible.unexpected_keys[:] = unexpected


def build_network(config: ActChunkedConfig, backbone_weights: str | None) -> ActNetwork:
    """The network that ``config`` describes."""
    features = config.feature_spec
    spec = LayerSpec(
        dim=config.dim_model,
        n_heads=config.n_heads,
        dim_feedforward=config.dim_feedforward,
        dropout=config.dropout,
        activation=config.feedforward_activation,
        pre_norm=config.pre_norm,
    )
    (action_dim,) = features.action
    n_queries = config.chunk_size // config.actions_per_query
    return ActNetwork(
        observation_encoder=_observation_encoder(config, backbone_weights),
        style_encoder=_style_encoder(config, spec) if config.use_vae else None,
        encoder=Encoder(spec, config.n_encoder_layers),
        decoder=Decoder(spec, config.n_decoder_layers, n_queries),
        head=RegressionHead(config.dim_model, action_dim, config.actions_per_query),
    )


def _observation_encoder(config: ActChunkedConfig, weights: str | None) -> ObservationEncoder:
    features = config.feature_spec
    dims = {key: dim for key, (dim,) in features.vectors.items()}
    vectors = VectorTokens(dims, config.dim_model) if dims else None
    cameras = None
    if features.images:
        backbone, channels = make_backbone(config.vision_backbone, config.backbone_norm, weights)
        cameras = CameraTokens(features.images, config.dim_model, backbone, channels)
    return ObservationEncoder(vectors, cameras)


def _style_encoder(config: ActChunkedConfig, spec: LayerSpec) -> StyleEncoder:
    features = config.feature_spec
    (action_dim,) = features.action
    (state_dim,) = features.vectors.get(OBS_STATE, (None,))
    return StyleEncoder(
        spec,
        n_layers=config.n_vae_encoder_layers,
        chunk_size=config.chunk_size,
        action_dim=action_dim,
        state_dim=state_dim,
        latent_dim=config.latent_dim,
    )


def not_finite(batch: Batch, metrics: dict[str, float]) -> DatasetError:
    """The error for a loss that is NaN or infinite, with its most likely cause."""
    key = first_non_finite(batch)
    cause = (
        "all inputs are finite: the weights have diverged, lower --policy.optimizer_lr"
        if key is None
        else f"{key!r} in the batch holds a NaN or an infinity: check the dataset"
    )
    return DatasetError(f"the loss is not finite ({metrics}); {cause}")
