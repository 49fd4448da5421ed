"""Settings of `act_chunked`."""

from dataclasses import dataclass
from typing import Literal

from lerobot.configs import PreTrainedConfig

from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.execution.settings import Mode
from lerobot_act_chunking.policies.act_chunked.presets import preset_values
from lerobot_act_chunking.policies.chunked_config import PRESET, ChunkedConfig


@PreTrainedConfig.register_subclass("act_chunked")
@dataclass
class ActChunkedConfig(ChunkedConfig):
    """Settings of `act_chunked`, under LeRobot's ACT names where both have them.

    Inputs may be any mix of ``observation.state``, further state vectors, ``observation.environment_state``
    and cameras of any shapes; at least one of them. Fields whose default is the preset's are resolved on
    construction: a saved config holds plain values, and a value given explicitly wins over the preset.

    Attributes (beside those of `ChunkedConfig`):
        preset: ``base`` (ours) or ``paper`` (LeRobot's ACT, with its normalisation and its optimiser).
            Pretrained backbone weights are the exception: neither preset asks for them.
        n_obs_steps: observation steps; only 1 so far.
        chunk_size: predicted actions per chunk.
        execution: how chunks become actions; this and the other fields of execution (``replan_interval``,
            ``latency_steps``, ``temporal_ensemble_coeff``, ...) are those of `ExecutionSettings`. ``base``
            replans four times a chunk and blends each new one in, ``paper`` runs each chunk to its end, as
            LeRobot does.
        actions_per_query: consecutive actions that each decoder query emits; divides ``chunk_size``. 1 is
            ACT; more makes long chunks cheap.
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

    Raises:
        ConfigurationError: on construction, naming the setting that cannot work.
    """

    preset: Literal["base", "paper"] = "base"

    chunk_size: int = 100
    actions_per_query: int = 1
    execution: Mode = PRESET

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

    def __post_init__(self) -> None:
        super().__post_init__()
        self._resolve_preset()
        self.check_choices()
        self._check()

    def _resolve_preset(self) -> None:
        pretrained = self.pretrained_backbone_weights is not None
        values = preset_values(self.preset, dim_model=self.dim_model, pretrained=pretrained)
        values["n_action_steps"] = self.timing.control_steps
        if (self.n_action_steps or self.timing.control_steps) == 1:
            values["execution"] = "open_loop"
        self.fill_in(values)

    def _check(self) -> None:
        if self.execution_settings.execution == "coherence":
            raise ConfigurationError(
                "execution=coherence chooses among sampled chunks, but act_chunked predicts a single one"
            )
        if self.n_obs_steps != 1:
            raise ConfigurationError(
                f"n_obs_steps={self.n_obs_steps}: act_chunked reads one observation step"
            )
        self.check_divides("chunk_size", "actions_per_query")
        self.check_divides("dim_model", "n_heads")
        if self.dim_model % 4:
            raise ConfigurationError(f"dim_model={self.dim_model} must be a multiple of 4 (image positions)")
        self.check_backbone()
        self.check_ranges(
            at_least_1=("n_encoder_layers", "n_decoder_layers", "n_vae_encoder_layers", "latent_dim"),
            fractions=("dropout",),
            not_negative=("kl_weight",),
        )

    @property
    def timing(self) -> ChunkTiming:
        """Which steps are observed and predicted."""
        return ChunkTiming(self.n_obs_steps, self.chunk_size, self.chunk_stride)
