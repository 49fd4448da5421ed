"""The encoder of `act_chunked` that starts from a language model."""

from typing import TYPE_CHECKING, cast

import torch
from torch import nn

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.nn.camera_summary import CameraSummaries
from lerobot_act_chunking.nn.language.encoder import TextEncoder, TextEncoderSpec
from lerobot_act_chunking.nn.language.make import Learning, make_text_encoder
from lerobot_act_chunking.nn.language.weights import language_model_folder, start
from lerobot_act_chunking.nn.observation import ObservationEncoder

if TYPE_CHECKING:
    from lerobot_act_chunking.policies.act_chunked.configuration_act_chunked import ActChunkedConfig

STYLE = 1  # token that stands before the observation's


def build_text_encoder(config: "ActChunkedConfig", observations: ObservationEncoder) -> TextEncoder:
    """A fresh encoder over an instruction and the tokens of an observation.

    Raises:
        ConfigurationError: the mixer, whose tokens have fixed places, and cells of images.
    """
    cameras = observations.cameras
    if config.encoder_impl == "mixer" and cameras is not None and not isinstance(cameras, CameraSummaries):
        raise ConfigurationError(
            f"encoder_impl=mixer has a place for each token, but image_tokens={config.image_tokens} makes as "
            "many as the images have cells: set --policy.image_tokens=summary"
        )
    n_cameras = 0 if cameras is None else len(cameras.keys)
    spec = TextEncoderSpec(
        dim=config.dim_model,
        n_heads=config.n_heads,
        dim_feedforward=config.dim_feedforward,
        n_layers=config.n_encoder_layers,
        dropout=config.dropout,
        vocabulary=config.encoder_vocabulary,
        text_tokens=config.encoder_text_tokens,
        n_robot_tokens=STYLE + observations.n_vector_tokens + n_cameras,
    )
    return make_text_encoder(config.encoder_impl, spec, cast(Learning, config.encoder_training))


def start_from_language(encoder: nn.Module, config: "ActChunkedConfig") -> None:
    """Fill in what ``encoder_init`` takes from the language model; what it permutes follows the run's seed.

    Raises:
        ConfigurationError: the language model is not here, or of other sizes.
    """
    assert isinstance(encoder, TextEncoder)  # noqa: S101
    folder = language_model_folder(config.encoder_weights, f"encoder_init={config.encoder_init}")
    generator = torch.Generator().manual_seed(int(torch.randint(2**62, ())))
    start(encoder, folder, config.encoder_init, generator)


def body_of(encoder: nn.Module) -> list[nn.Parameter]:
    """A text encoder's weights that learn, without the norm of the robot's tokens; none of another one."""
    if not isinstance(encoder, TextEncoder):
        return []
    own = set(encoder.robot_norm.parameters())
    return [each for each in encoder.parameters() if each.requires_grad and each not in own]
