"""Settings of `vqbet_chunked`."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

from lerobot.configs import NormalizationMode, PreTrainedConfig
from lerobot.optim import LRSchedulerConfig

from act_chunking_runtime.settings import Mode
from lerobot_act_chunking.data.fast_chunks.image_switch import ImageSwitch
from lerobot_act_chunking.data.timing import ChunkTiming, QueryTiming
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.choices import one_of
from lerobot_act_chunking.policies.chunked_config import PRESET, ChunkedConfig
from lerobot_act_chunking.policies.vqbet_chunked.checks import check
from lerobot_act_chunking.policies.vqbet_chunked.presets import PRESETS, preset_values
from lerobot_act_chunking.policies.vqbet_chunked.schedule import (
    TokenizerThenPolicySchedulerConfig,
    steps_left,
)
from lerobot_act_chunking.policies.vqbet_chunked.tokenizer_file import TokenizerInfo, read_info
from lerobot_act_chunking.tokenizers.coders import CODERS
from lerobot_act_chunking.tokenizers.make import TOKENIZERS
from lerobot_act_chunking.tokenizers.spec import TokenizerSpec


@PreTrainedConfig.register_subclass("vqbet_chunked")
@dataclass
class VqbetChunkedConfig(ChunkedConfig):
    """Settings of `vqbet_chunked`, under the names of LeRobot's `vqbet` where both have them.

    Inputs may be any mix of state vectors and cameras, as for `act_chunked`. Fields without a default here
    are resolved on construction: from the tokenizer file if there is one, else from the preset.

    Attributes (beside those of `ChunkedConfig`):
        preset: ``base`` (ours) or ``paper`` (LeRobot's `vqbet`).
        n_obs_steps: number of observations that the policy reads, the current one last.
        execution: how chunks become actions, a mode of `ExecutionSettings`. Where it is not given and the
            dataset's actions are changes of the state, such as displacements, training chooses ``receding``.
        chunk_size: predicted actions per chunk, ``chunk_stride`` control steps apart (LeRobot's
            ``action_chunk_size``). Where it is not given, training fits it to the dataset: two seconds at 50
            control steps a second and less, and at most half of an episode.
        prefix_steps: train with up to so many given first actions [control steps], for a robot that moves
            while the next chunk is computed: set the longest delay. Acting then continues what is executed
            meanwhile (``latency_steps``, ``background`` or ``lerobot-rollout --inference.type=rtc``).
        n_action_pred_token: chunks predicted in training from the current step on, each one control step
            later. Only the first one acts; the others, and those of earlier observations, train the network.
        tokenizer: what turns chunks into codes: ``residual_vq`` (VQ-BeT), ``fsq`` (finite scalar
            quantisation, Mentzer et al. 2023), ``uniform`` bins of every action, or ``dct`` coefficients
            (FAST, Pertsch et al. 2025, without its byte pairs).
        tokenizer_path: a tokenizer that ``act-chunking train-tokenizer`` made; frozen from the first step.
        tokenizer_training: without such a file, train it in the first ``n_vqvae_training_steps`` of the run
            (``in_loop``) or together with the policy to the end (``joint``).
        n_vqvae_training_steps: optimiser steps for the tokenizer, before those for the policy.
        vqvae_n_embed: M, codes per level.
        vqvae_num_layers: G, levels of residual quantisation.
        vqvae_embedding_dim: width of a code.
        vqvae_enc_hidden_dim: hidden width of the tokenizer's encoder and decoder.
        vqvae_coder: ``mlp`` over the whole chunk (VQ-BeT), or ``conv`` along it.
        vqvae_decay: decay of the codebook's moving average.
        commitment_weight: beta, weight of the loss that draws encodings to their codes.
        kmeans_iters: k-means iterations that place the first codes; 0 for random codes.
        dead_code_threshold: a code that is used less than this share of the average use (moving average) is
            placed anew; 0 never.
        rotation_trick: pass gradients through the quantiser by rotation (Fifty et al. 2024), not straight.
        fsq_levels: values of each dimension of a code of ``fsq``; M is their product.
        n_bins: number of bins of ``uniform`` and ``dct``.
        dct_coefficients: coefficients that ``dct`` keeps for each action dimension.
        optimizer_vqvae_lr: the tokenizer's learning rate.
        optimizer_vqvae_weight_decay: the tokenizer's weight decay.
        gpt_hidden_dim: width of the GPT.
        gpt_n_layer: number of layers of the GPT.
        gpt_n_head: attention heads of the GPT.
        dropout: dropout probability in the GPT.
        head_hidden_dims: hidden layers of the code head and the offset head.
        sequentially_select: choose each code knowing those before it; otherwise all at once.
        focal_gamma: gamma of the focal loss of the codes; 0 is cross-entropy.
        primary_code_loss_weight: weight of the first code's loss (of all codes', if none refines another).
        secondary_code_loss_weight: weight of each further code's loss.
        offset_mode: the offset from the decoded chunk comes from a head that sees that chunk
            (``code_conditioned``), or from one that holds an offset for every code (``table``, LeRobot's).
        offset_target: learn the offset at the demonstration's code (``gt_code``) or at a sampled one
            (``sampled``, LeRobot's).
        offset_loss_weight: weight of the offset's loss.
        bet_softmax_temperature: temperature of sampling codes; 0 always takes the likeliest.
        top_p: sample among the likeliest codes that together have this probability.
        code_hold: draw the random numbers that pick codes for every ``chunk``, or once an ``episode``.
        spatial_softmax_num_keypoints: image keypoints per camera.
        noise_seed: seed of sampling codes when acting; every episode of every environment has a stream of its
            own.

    Raises:
        ConfigurationError: on construction, naming the setting that cannot work.
    """

    presets = PRESETS
    preset: str = "base"

    n_obs_steps: int = PRESET
    chunk_size: int = PRESET
    prefix_steps: int = 0
    n_action_pred_token: int = PRESET
    execution: Mode = PRESET

    tokenizer: str = one_of(TOKENIZERS, PRESET)
    tokenizer_path: str | None = None
    tokenizer_training: Literal["in_loop", "joint"] = "in_loop"
    n_vqvae_training_steps: int = PRESET
    vqvae_n_embed: int = PRESET
    vqvae_num_layers: int = PRESET
    vqvae_embedding_dim: int = PRESET
    vqvae_enc_hidden_dim: int = PRESET
    vqvae_coder: str = one_of(CODERS, PRESET)
    vqvae_decay: float = PRESET
    commitment_weight: float = PRESET
    kmeans_iters: int = PRESET
    dead_code_threshold: float = PRESET
    rotation_trick: bool = PRESET
    fsq_levels: tuple[int, ...] = PRESET
    n_bins: int = PRESET
    dct_coefficients: int = PRESET
    optimizer_vqvae_lr: float = 1e-3
    optimizer_vqvae_weight_decay: float = 1e-4

    gpt_hidden_dim: int = PRESET
    gpt_n_layer: int = PRESET
    gpt_n_head: int = PRESET
    dropout: float = PRESET
    head_hidden_dims: tuple[int, ...] = PRESET
    sequentially_select: bool = PRESET
    focal_gamma: float = PRESET
    primary_code_loss_weight: float = 5.0
    secondary_code_loss_weight: float = 0.5
    offset_mode: Literal["code_conditioned", "table"] = PRESET
    offset_target: Literal["gt_code", "sampled"] = PRESET
    offset_loss_weight: float = PRESET

    bet_softmax_temperature: float = PRESET
    top_p: float = PRESET
    code_hold: Literal["chunk", "episode"] = "chunk"

    spatial_softmax_num_keypoints: int = 32
    noise_seed: int = 0

    use_ema: bool = PRESET
    ema_max_value: float = 0.999
    optimizer_weight_decay: float = PRESET

    def __post_init__(self) -> None:
        super().__post_init__()
        self._resolve()
        check(self)

    def _resolve(self) -> None:
        """Fill in what was not given, from the tokenizer file and the preset.

        A configuration from a checkpoint has all its values, and the file may be gone.
        """
        self.resolve_seconds()
        values = preset_values(self.preset, tokenizer=self.tokenizer, pretrained=self.starts_pretrained)
        if self.tokenizer_path is not None and any(getattr(self, name) is PRESET for name in values):
            self._adopt(read_info(Path(self.tokenizer_path)))
        self.fill_in(values)

    def _adopt(self, info: TokenizerInfo) -> None:
        """Take over what the tokenizer file says.

        Raises:
            ConfigurationError: naming a setting that contradicts it.
        """
        for name, value in info.policy_fields.items():
            given = getattr(self, name)
            if given is not PRESET and given != value:
                raise ConfigurationError(
                    f"{name}={given}, but tokenizer_path={self.tokenizer_path} was made with {name}={value}: "
                    f"leave out --policy.{name}, or train another tokenizer"
                )
            setattr(self, name, value)
        mode = NormalizationMode(info.normalization)
        self.normalization_mapping = {"ACTION": mode, **(self.normalization_mapping or {})}

    @property
    def timing(self) -> ChunkTiming:
        """Which steps are observed, and predicted when acting."""
        return ChunkTiming(self.n_obs_steps, self.chunk_size, self.chunk_stride)

    @property
    def queries(self) -> QueryTiming:
        """Which steps are predicted in training."""
        return QueryTiming(self.timing, self.n_action_pred_token)

    @property
    def action_delta_indices(self) -> list[int]:
        """Steps of the actions LeRobot loads."""
        return self.queries.steps

    @cached_property
    def image_switch(self) -> ImageSwitch:
        """Tells the training's data workers for which batches the policy looks at images."""
        return ImageSwitch()

    @property
    def tokenizer_spec(self) -> TokenizerSpec:
        """What the tokenizer is built from."""
        (action_dim,) = self.feature_spec.action
        return TokenizerSpec.from_fields(self, chunk_size=self.chunk_size, action_dim=action_dim)

    @property
    def tokenizer_steps(self) -> int:
        """Optimiser steps of a fresh run that train the tokenizer alone."""
        learned = TOKENIZERS[self.tokenizer].is_learned and self.tokenizer_path is None
        return self.n_vqvae_training_steps if learned and self.tokenizer_training == "in_loop" else 0

    def get_scheduler_preset(self) -> LRSchedulerConfig | None:
        """The learning-rate schedule over the whole run; None if the rate never changes."""
        tokenizer_steps = steps_left(self.tokenizer_steps, self.pretrained_path)
        if not tokenizer_steps:
            return super().get_scheduler_preset()
        return TokenizerThenPolicySchedulerConfig(
            self.lr_warmup_steps, tokenizer_steps, cosine=self.lr_schedule == "cosine"
        )
