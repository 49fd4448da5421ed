"""Settings of `act_chunked`."""

import math
from dataclasses import dataclass, replace
from typing import Literal

from lerobot.configs import PreTrainedConfig

from act_chunking_runtime.settings import Mode
from lerobot_act_chunking.data.batch import FeatureSpec
from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.heads.make import HEADS
from lerobot_act_chunking.heads.spec import HeadSpec
from lerobot_act_chunking.nn.language.weights import INITS
from lerobot_act_chunking.nn.latents.make import LATENTS
from lerobot_act_chunking.nn.latents.spec import COMPONENT_WEIGHTS, LatentSpec
from lerobot_act_chunking.policies.act_chunked.checks import check
from lerobot_act_chunking.policies.act_chunked.presets import FORMER_NAMES, PRESETS, preset_values
from lerobot_act_chunking.policies.choices import one_of
from lerobot_act_chunking.policies.chunked_config import PRESET, ChunkedConfig
from lerobot_act_chunking.policies.language.encoder import MINILM
from lerobot_act_chunking.policies.prefix import prefix_predictions


@PreTrainedConfig.register_subclass("act_chunked")
@dataclass
class ActChunkedConfig(ChunkedConfig):
    """Settings of `act_chunked`, under LeRobot's ACT names where both have them.

    Inputs may be any mix of ``observation.state``, further state vectors, ``observation.environment_state``
    and cameras of any shapes; at least one of them. Fields whose default is the preset's are resolved on
    construction: a saved config holds plain values, and a value given explicitly wins over the preset.

    Attributes (beside those of `ChunkedConfig`):
        preset: ``base`` (ours), ``paper`` (LeRobot's ACT, with its normalisation and its optimiser) or
            ``autoregressive`` (observation history, velocities, an autoregressive decoder, a sampled latent).
            Pretrained backbone weights are the exception: no preset asks for them.
        execution: how chunks become actions, a mode of `ExecutionSettings`. ``base`` replans four times a
            chunk and blends each new one in, ``paper`` runs each chunk to its end, as LeRobot does. Where it
            is not given and the dataset's actions are changes of the state, such as displacements, training
            chooses ``receding``.

        n_obs_steps: number of observations that the policy reads, the current one last.
        obs_stride: control steps between two observations.
        history_dropout: how often training shows the current observation in place of the earlier ones.
        image_tokens: each camera's image is a token for every cell of its feature map (``cells``, ACT), or a
            single one that knows where things are (``summary``): cheaper, and learned from few frames.
        history_image_grid: cells a side to which the feature maps of earlier images are averaged.
        use_velocity: give the policy the change of the state vectors between the last two observations, too.
        random_shift: training moves images by up to so many pixels each way.

        chunk_size: predicted actions per chunk, ``chunk_stride`` control steps apart. Where it is not given,
            training fits it to the dataset: two seconds at 50 control steps a second and less, and at most
            half of an episode.
        actions_per_query: consecutive actions that each decoder query emits; divides ``chunk_size``. 1 is
            ACT; more makes long chunks cheap. ``base`` takes what lasts ten control steps.
        prefix_steps: train with up to so many given first actions [control steps], for a robot that moves
            while the next chunk is computed: set the longest delay. Acting then continues what is executed
            meanwhile (``latency_steps``, ``background`` or ``lerobot-rollout --inference.type=rtc``).
        decoder_type: ``parallel`` decodes all queries at once (ACT); ``autoregressive`` one after the other,
            each knowing the actions before it.
        teacher_noise_std: noise on the earlier actions that autoregressive training shows to the decoder
            [normalised units].
        teacher_dropout: how often autoregressive training hides the earlier actions from the decoder.

        pre_norm: normalise before each transformer branch instead of after it.
        dim_model: token width, a multiple of 4 and of ``n_heads``.
        n_heads: attention heads.
        dim_feedforward: hidden width of the feed-forward branches.
        feedforward_activation: activation of the feed-forward branches.
        n_encoder_layers: number of encoder layers; of a language model the first ones.
        encoder_impl: the encoder over the tokens of an observation: ``act``; ``bert``, whose layers are those
            of a language model, MiniLM's six of width 384 by default; or ``mixer``, an MLP-Mixer with as
            many weights, for comparison.
        encoder_init: what ``bert`` or ``mixer`` begin with: ``random``, a ``language_model``, one whose
            entries are ``permuted`` within each tensor, or one kind of its weights alone
            (``only_attention``, ``only_mlp``, ``only_norms``, ``only_positions``, ``only_embeddings``).
            Checkpoints hold the weights.
        encoder_weights: folder of the language model: BERT-like, or pretrained by
            ``act-chunking lm-ablation``. By default MiniLM of the extra ``language``.
        encoder_training: the body learns in ``full``, stays ``frozen``, or learns low-rank changes
            (``lora``). Its table of word pieces never changes.
        encoder_vocabulary: word pieces of the instruction that the encoder knows, 30522 of MiniLM's; 0 for
            an encoder that reads none. They are those of ``encoder_weights``, or MiniLM's.
        encoder_text_tokens: word pieces of the longest instruction.
        optimizer_lr_encoder: AdamW learning rate of the body of ``bert`` or ``mixer``; by default
            ``optimizer_lr``.
        n_decoder_layers: number of decoder layers; parallel action queries interact from the second on.
        dropout: dropout probability everywhere in the transformers.

        action_likelihood: how actions are predicted and scored: ``l1`` (ACT), ``l2``, ``laplace``,
            ``gaussian``, ``gmm`` (a mixture whose component holds for the whole chunk) or ``categorical``
            (uniform bins).
        nll_beta, min_std, n_components, n_bins, hl_gauss_sigma, soft_local_bins: see `HeadSpec`.
        action_temperature: 0 acts with the mean or the likeliest action; above, actions are sampled.
        action_top_k: sample among so many bins (0: all).
        pad_normalization: average the action error over ``valid`` elements (LeRobot) or ``all`` (original
            ACT).

        use_vae: learn a latent style of each demonstration.
        latent_type: prior of the latent: ``gaussian`` (ACT), ``conditional`` on the observation, ``mixture``
            or ``categorical``.
        latent_dim: size of the latent.
        n_latent_components: components of a ``mixture``, codes of a ``categorical`` latent.
        latent_warmup_steps: training steps until the components are placed, or over which codes harden.
        prior_component_weights: how often each component or code of the latent is sampled: as in training
            (``empirical``) or ``uniform``.
        z_inference: act with the ``mode`` of the prior (zero for a gaussian one, as ACT) or ``sample`` it.
        z_temperature: factor on the spread of the prior that the latent is sampled from.
        z_hold: keep a sampled latent for a ``chunk``, for ``z_hold_steps`` control ``steps``, or for the
            ``episode``.
        z_hold_steps: how long a sampled latent is kept with ``z_hold=steps`` [control steps].
        allow_mode_mixing: let ``execution=ensemble`` average chunks of different latents.
        n_vae_encoder_layers: layers of the style encoder.
        style_observations: the style encoder reads the ``state`` (ACT) or ``all`` observations beside the
            actions.
        vae_action_stride: the style encoder reads averages of so many consecutive actions.
        kl_weight: weight of the KL divergence [nats, summed over dimensions] beside the mean action error.
        kl_anneal: let ``kl_weight`` grow from 0 over the first ``kl_anneal_steps`` (``linear``), or again in
            every such period (``cyclical``).
        kl_anneal_steps: length of this growth [optimiser steps].
        free_bits: KL divergence that each dimension of the latent may have without a loss [nats].

        compile_model: compile the network with torch.compile, for any batch size. The first step takes a
            minute or two; on a CPU it gains a few percent of the later ones.
        noise_seed: seed of sampling when acting; every episode of every environment has a stream of its own.

    Raises:
        ConfigurationError: on construction, naming the setting that cannot work.
    """

    choices = {"feedforward_activation": ("relu", "gelu")}  # noqa: RUF012  (ClassVar in the base)

    presets = PRESETS
    preset: str = "base"
    execution: Mode = PRESET

    n_obs_steps: int = PRESET
    obs_stride: int = PRESET
    history_dropout: float = PRESET
    image_tokens: Literal["cells", "summary"] = "cells"
    history_image_grid: int = 1
    use_velocity: bool = PRESET

    random_shift: int = 0

    chunk_size: int = PRESET
    actions_per_query: int = PRESET
    prefix_steps: int = 0
    decoder_type: Literal["parallel", "autoregressive"] = PRESET
    teacher_noise_std: float = 0.05
    teacher_dropout: float = 0.3

    pre_norm: bool = PRESET
    dim_model: int = PRESET
    n_heads: int = PRESET
    dim_feedforward: int = PRESET
    feedforward_activation: str = PRESET
    n_encoder_layers: int = PRESET
    encoder_impl: Literal["act", "bert", "mixer"] = "act"
    encoder_init: str = one_of(INITS, "random")
    encoder_weights: str | None = None
    encoder_training: Literal["full", "frozen", "lora"] = "full"
    encoder_vocabulary: int = 0
    encoder_text_tokens: int = 32
    optimizer_lr_encoder: float = PRESET
    n_decoder_layers: int = PRESET
    dropout: float = PRESET

    action_likelihood: str = one_of(HEADS, "l1")
    nll_beta: float = 0.5
    min_std: float = 1e-2
    n_components: int = 5
    n_bins: int = 256
    hl_gauss_sigma: float = 0.75
    soft_local_bins: int = 2
    action_temperature: float = 0.0
    action_top_k: int = 0
    pad_normalization: Literal["valid", "all"] = "valid"

    use_vae: bool = PRESET
    latent_type: str = one_of(LATENTS, "gaussian")
    latent_dim: int = PRESET
    n_latent_components: int = 8
    latent_warmup_steps: int = 1000
    prior_component_weights: str = one_of(COMPONENT_WEIGHTS, "empirical")
    z_inference: Literal["mode", "sample"] = PRESET
    z_temperature: float = 1.0
    z_hold: Literal["chunk", "steps", "episode"] = "episode"
    z_hold_steps: int = 0
    allow_mode_mixing: bool = False
    n_vae_encoder_layers: int = PRESET
    style_observations: Literal["state", "all"] = PRESET
    vae_action_stride: int = PRESET
    kl_weight: float = PRESET
    kl_anneal: Literal["none", "linear", "cyclical"] = "none"
    kl_anneal_steps: int = 10_000
    free_bits: float = PRESET

    compile_model: bool = False
    noise_seed: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        self.resolve_seconds()
        self.preset = FORMER_NAMES.get(self.preset, self.preset)
        self.fill_in(preset_values(self))
        if self.optimizer_lr_encoder is PRESET:
            self.optimizer_lr_encoder = self.optimizer_lr
        check(self)

    @property
    def feature_spec(self) -> FeatureSpec:
        """What the policy reads from a batch."""
        reads = self.encoder_text_tokens if self.encoder_vocabulary else 0
        return replace(super().feature_spec, text_tokens=reads)

    @property
    def task_tokens(self) -> tuple[str, int] | None:
        """As of every policy, or those that the encoder itself reads."""
        if self.encoder_vocabulary:
            return self.encoder_weights or MINILM, self.encoder_text_tokens
        return super().task_tokens

    @property
    def timing(self) -> ChunkTiming:
        """Which steps are observed and predicted."""
        return ChunkTiming(self.n_obs_steps, self.chunk_size, self.chunk_stride, obs_stride=self.obs_stride)

    def validate_features(self) -> None:
        """Check the inputs and outputs that LeRobot filled in from the dataset or the environment.

        Raises:
            FeatureError: naming what is missing or has an unusable shape.
            ConfigurationError: if a setting asks for what they do not have.
        """
        super().validate_features()
        if self.use_velocity and not self.feature_spec.vectors:
            raise ConfigurationError(
                "use_velocity=True tells how fast state vectors change, but the inputs are images alone: set "
                "--policy.use_velocity=false"
            )

    @property
    def head_spec(self) -> HeadSpec:
        """What the action head is made from."""
        return HeadSpec.from_fields(self)

    @property
    def latent_spec(self) -> LatentSpec:
        """What the latent is made from."""
        return LatentSpec.from_fields(self)

    @property
    def bounded(self) -> bool:
        """Whether only actions in [-1, 1] are predicted."""
        return HEADS[self.action_likelihood].is_bounded

    @property
    def is_stochastic(self) -> bool:
        """Whether two chunks for the same observation may differ."""
        return self.action_temperature > 0 or (self.use_vae and self.z_inference == "sample")

    @property
    def training_is_stochastic(self) -> bool:
        """Whether training draws random numbers beside dropout."""
        return (
            self.use_vae
            or self.decoder_type == "autoregressive"
            or self.history_dropout > 0
            or self.random_shift > 0
            or self.prefix_steps > 0
        )

    @property
    def prefix_predictions(self) -> int:
        """How many of a chunk's first predictions may be given."""
        return prefix_predictions(self)

    @property
    def loss_name(self) -> str:
        """What the loss of the actions is called where it is logged."""
        return f"{self.action_likelihood}_loss"

    @property
    def hold_steps(self) -> float:
        """Control steps for which a sampled latent is kept."""
        return {"chunk": 0, "steps": self.z_hold_steps, "episode": math.inf}[self.z_hold]
