"""The network of `diffusion_chunked`: what is observed, and the denoiser that it conditions."""

from torch import nn

from lerobot_act_chunking.nn.condition import CameraKeypoints, ConditionTokens, ConditionVector
from lerobot_act_chunking.nn.denoisers.denoiser import Denoiser
from lerobot_act_chunking.nn.denoisers.make import DENOISERS, make_denoiser
from lerobot_act_chunking.nn.denoisers.spec import DenoiserInputs, DenoiserSpec
from lerobot_act_chunking.nn.denoisers.time import StepEmbedding, UnitTimeEmbedding
from lerobot_act_chunking.nn.instruction import InstructionEmbedding
from lerobot_act_chunking.nn.observation import CameraTokens
from lerobot_act_chunking.nn.vision import make_backbone
from lerobot_act_chunking.policies.diffusion_chunked.configuration_diffusion_chunked import (
    DiffusionChunkedConfig,
)
from lerobot_act_chunking.policies.language.make import instruction_dims, make_instruction


class DiffusionNetwork(nn.Module):
    """Two parts that are called apart: the observation once per chunk, the denoiser once per step."""

    def __init__(
        self,
        condition: ConditionVector | ConditionTokens,
        denoiser: Denoiser,
        instruction: InstructionEmbedding | None = None,
    ):
        super().__init__()
        self.condition = condition
        self.denoiser = denoiser
        self.instruction = instruction


def build_network(config: DiffusionChunkedConfig, backbone_weights: str | None) -> DiffusionNetwork:
    """The network that ``config`` describes."""
    instruction = make_instruction(config)
    condition = _condition(config, backbone_weights, instruction_dims(instruction))
    return DiffusionNetwork(condition, _denoiser(config, condition), instruction)


def _condition(
    config: DiffusionChunkedConfig, weights: str | None, told: dict[str, int]
) -> ConditionVector | ConditionTokens:
    """Reads what is observed, and vectors of what the policy is told."""
    features = config.feature_spec
    dims = {key: dim for key, (dim,) in features.vectors.items()} | told
    dropped = config.left_out
    backbone = (
        make_backbone(config.vision_backbone, config.backbone_norm, weights) if features.images else None
    )
    if DENOISERS[config.denoiser].reads_tokens:
        cameras = None if backbone is None else CameraTokens(features.seen, config.dim_model, *backbone)
        return ConditionTokens(dims, config.n_obs_steps, cameras, config.dim_model, null_features=dropped)
    cameras = (
        None
        if backbone is None
        else CameraKeypoints(features.seen, config.spatial_softmax_num_keypoints, *backbone)
    )
    return ConditionVector(dims, config.n_obs_steps, cameras, null_features=dropped)


def _denoiser(config: DiffusionChunkedConfig, condition: ConditionVector | ConditionTokens) -> Denoiser:
    (action_dim,) = config.feature_spec.action
    embedding = StepEmbedding if config.objective == "ddpm" else UnitTimeEmbedding
    return make_denoiser(
        DenoiserSpec.from_fields(config), DenoiserInputs(action_dim, condition.dim, embedding)
    )
