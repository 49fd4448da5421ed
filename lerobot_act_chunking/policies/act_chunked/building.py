"""The network of `act_chunked` from its settings."""

from typing import cast

from lerobot.utils.constants import OBS_STATE

from lerobot_act_chunking.heads.make import make_action_head
from lerobot_act_chunking.heads.spec import HeadSize
from lerobot_act_chunking.nn.autoregressive import AutoregressiveDecoder
from lerobot_act_chunking.nn.camera_summary import CameraSummaries
from lerobot_act_chunking.nn.latents.latent import Latent
from lerobot_act_chunking.nn.latents.make import make_latent
from lerobot_act_chunking.nn.layers import Activation, LayerSpec
from lerobot_act_chunking.nn.observation import CameraTokens, ObservationEncoder, VectorTokens
from lerobot_act_chunking.nn.prefix import PrefixEncoder
from lerobot_act_chunking.nn.style_encoder import StyleEncoder, StyleInput
from lerobot_act_chunking.nn.transformer import Decoder, Encoder
from lerobot_act_chunking.nn.velocity import FiniteDifferences
from lerobot_act_chunking.nn.vision import make_backbone
from lerobot_act_chunking.policies.act_chunked.configuration_act_chunked import ActChunkedConfig
from lerobot_act_chunking.policies.act_chunked.language import build_text_encoder
from lerobot_act_chunking.policies.act_chunked.network import ActNetwork
from lerobot_act_chunking.policies.language.make import make_instruction


def build_network(config: ActChunkedConfig, backbone_weights: str | None) -> ActNetwork:
    """The network that ``config`` describes."""
    spec = LayerSpec(
        dim=config.dim_model,
        n_heads=config.n_heads,
        dim_feedforward=config.dim_feedforward,
        dropout=config.dropout,
        activation=cast(Activation, config.feedforward_activation),
        pre_norm=config.pre_norm,
    )
    (action_dim,) = config.feature_spec.action
    n_queries = config.chunk_size // config.actions_per_query
    observation_encoder = _observation_encoder(config, backbone_weights)
    latent = style_encoder = None
    if config.use_vae:
        latent = make_latent(config.latent_spec, config.dim_model)
        style_encoder = _style_encoder(config, spec, latent, observation_encoder.n_vector_tokens)
    return ActNetwork(
        dim=config.dim_model,
        observation_encoder=observation_encoder,
        style_encoder=style_encoder,
        latent=latent,
        encoder=Encoder(spec, config.n_encoder_layers)
        if config.encoder_impl == "act"
        else build_text_encoder(config, observation_encoder),
        decoder=_decoder(config, spec, n_queries, action_dim),
        head=make_action_head(
            config.head_spec, HeadSize(config.dim_model, action_dim, n_queries, config.actions_per_query)
        ),
        prefix_encoder=PrefixEncoder(config.prefix_predictions, action_dim, config.dim_model)
        if config.prefix_steps
        else None,
        instruction=make_instruction(config),
    )


def _decoder(
    config: ActChunkedConfig, spec: LayerSpec, n_queries: int, action_dim: int
) -> Decoder | AutoregressiveDecoder:
    if config.decoder_type == "parallel":
        return Decoder(spec, config.n_decoder_layers, n_queries)
    return AutoregressiveDecoder(
        spec, config.n_decoder_layers, n_queries, config.actions_per_query, action_dim
    )


def _observation_encoder(config: ActChunkedConfig, weights: str | None) -> ObservationEncoder:
    features = config.feature_spec
    dims = {key: dim for key, (dim,) in features.vectors.items()}
    cameras = None
    if features.images:
        backbone, channels = make_backbone(config.vision_backbone, config.backbone_norm, weights)
        kind = CameraSummaries if config.image_tokens == "summary" else CameraTokens
        cameras = kind(features.seen, config.dim_model, backbone, channels)
    return ObservationEncoder(
        vectors=VectorTokens(dims, config.dim_model) if dims else None,
        cameras=cameras,
        n_obs_steps=config.n_obs_steps,
        differences=FiniteDifferences(dims) if config.use_velocity else None,
        history_image_grid=config.history_image_grid,
    )


def _style_encoder(
    config: ActChunkedConfig, spec: LayerSpec, latent: Latent, n_vector_tokens: int
) -> StyleEncoder:
    features = config.feature_spec
    (action_dim,) = features.action
    (state_dim,) = features.vectors.get(OBS_STATE, (None,))
    sees = StyleInput(
        chunk_size=config.chunk_size,
        action_dim=action_dim,
        state_dim=state_dim,
        n_vector_tokens=n_vector_tokens if config.style_observations == "all" else None,
        action_stride=config.vae_action_stride,
    )
    return StyleEncoder(
        spec,
        sees,
        n_layers=config.n_vae_encoder_layers,
        latent_dim=latent.dim,
        n_parameters=latent.n_parameters,
    )
