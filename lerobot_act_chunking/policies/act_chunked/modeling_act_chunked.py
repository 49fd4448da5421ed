"""The `act_chunked` policy: ACT's wiring of the package's blocks into LeRobot's contract."""

import math
from typing import Any, Literal

import torch
from lerobot.utils.constants import OBS_STATE
from torch import Tensor, nn

from lerobot_act_chunking.data.batch import ActionTarget, Observation
from lerobot_act_chunking.data.masking import per_sample_error
from lerobot_act_chunking.execution.interpolation import upsample
from lerobot_act_chunking.execution.timeline import Environments
from lerobot_act_chunking.heads.regression import RegressionHead
from lerobot_act_chunking.nn.observation import CameraTokens, ObservationEncoder, VectorTokens
from lerobot_act_chunking.nn.style import StyleEncoder, kl_to_standard_normal, sample_latent
from lerobot_act_chunking.nn.transformer import Decoder, Encoder, LayerSpec
from lerobot_act_chunking.nn.vision import make_backbone
from lerobot_act_chunking.policies.act_chunked.configuration_act_chunked import ActChunkedConfig
from lerobot_act_chunking.policies.act_chunked.network import ActNetwork
from lerobot_act_chunking.policies.chunked_policy import Batch, ChunkedPolicy, not_finite


class ActChunkedPolicy(ChunkedPolicy[ActChunkedConfig, ActNetwork]):
    """Action Chunking with Transformers (Zhao et al. 2023) over any mix of state vectors and cameras."""

    config_class = ActChunkedConfig  # pyright: ignore[reportAssignmentType]  (LeRobot declares None)
    name = "act_chunked"  # pyright: ignore[reportAssignmentType]
    _fsdp_wrap_modules = ["EncoderLayer", "DecoderLayer"]  # noqa: RUF012 (LeRobot's declaration of its type)

    def _build(self, backbone_weights: str | None) -> ActNetwork:
        return build_network(self.config, backbone_weights)

    @property
    def _backbone(self) -> nn.Module | None:
        cameras = self.model.observation_encoder.cameras
        return None if cameras is None else cameras.backbone

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

    @torch.no_grad()
    def predict_action_chunk(self, batch: Batch, **_: Any) -> Tensor:
        """The whole chunk of normalised actions (B, T, A), one per control step; needs no earlier call."""
        self.eval()
        window = Observation.window_from_lerobot(batch, self.feature_spec, self.config.n_obs_steps)
        return self._predict(window, None, self.config.timing.control_steps)

    def _predict(self, window: Observation, envs: Environments, n_steps: int) -> Tensor:
        config = self.config
        n_predictions = config.timing.predictions_for(n_steps)
        n_queries = math.ceil(n_predictions / config.actions_per_query)
        keyframes = self._network(window.latest(), n_queries=n_queries)[:, :n_predictions]
        return upsample(keyframes, config.chunk_stride, config.gripper_dims)[:, :n_steps]

    def _get_default_peft_targets(self) -> dict[str, Any]:
        """Adapt all attention projections and feed-forward layers of the encoder and decoder."""
        return {
            "target_modules": r"model\.(encoder|decoder)\..*\.([qkv]_proj|out_proj|expand|contract)",
            "modules_to_save": ["head"],
        }


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
