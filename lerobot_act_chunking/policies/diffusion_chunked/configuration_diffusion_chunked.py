"""Settings of `diffusion_chunked`."""

import math
from dataclasses import dataclass, field
from typing import Any, Literal

from lerobot.configs import PreTrainedConfig
from lerobot.policies.rtc.configuration_rtc import RTCConfig

from act_chunking_runtime.settings import Mode
from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.errors import ConfigurationError, FeatureError
from lerobot_act_chunking.nn.denoisers.make import DENOISERS
from lerobot_act_chunking.nn.denoisers.unet1d import SIZES
from lerobot_act_chunking.policies.choices import one_of
from lerobot_act_chunking.policies.chunked_config import PRESET, ChunkedConfig
from lerobot_act_chunking.policies.diffusion_chunked.checks import check
from lerobot_act_chunking.policies.diffusion_chunked.presets import PRESETS, preset_values
from lerobot_act_chunking.policies.language.fields import INSTRUCTION
from lerobot_act_chunking.sampling.continuation import Jacobian, PrefixSchedule
from lerobot_act_chunking.sampling.process import BETA_SCHEDULES, PROCESSES, TIME_DISTRIBUTIONS
from lerobot_act_chunking.sampling.samplers import CLIP_MODES, SAMPLERS, Spacing

WarmStart = Literal["none", "noise_hold", "sdedit", "rtc", "prefix"]
SAMPLER_NAMES = tuple(name for names in SAMPLERS.values() for name in names)
PREDICTION_TYPES = tuple(dict.fromkeys(name for each in PROCESSES.values() for name in each.prediction_types))


@PreTrainedConfig.register_subclass("diffusion_chunked")
@dataclass
class DiffusionChunkedConfig(ChunkedConfig):
    """Settings of `diffusion_chunked`, under LeRobot's diffusion names where both have them.

    Inputs may be any mix of state vectors and cameras, as for `act_chunked`. Fields without a default here
    are resolved on construction, from the preset and the objective.

    Attributes (beside those of `ChunkedConfig`):
        preset: ``base`` (ours) or ``paper`` (LeRobot's `diffusion`: its U-Net, noise schedule, normalisation,
            horizon and execution).
        objective: ``flow`` matching (Lipman et al. 2023, rectified flow), ``ddpm`` (Ho et al. 2020), or
            ``two_step`` regression (MIP, arXiv 2512.01809).
        denoiser: ``mixer`` (fastest on a CPU), ``dit`` (attends to observation tokens) or ``unet1d``
            (Diffusion Policy's).
        n_obs_steps: number of observations that condition a chunk, the current one last.
        horizon: predicted actions per chunk, ``chunk_stride`` control steps apart. Where it is not given,
            training fits it to the dataset: two seconds at 50 control steps a second and less, and at most
            half of an episode.
        execution: how chunks become actions, a mode of `ExecutionSettings`. Where it is not given and the
            dataset's actions are changes of the state, such as displacements, training chooses ``receding``.
        align: the first predicted action belongs to the ``current`` step, or to the ``first_obs`` as in
            Diffusion Policy, whose chunks begin in the past.
        prediction_type: what the network is asked for: ``velocity`` or ``sample`` (flow), ``epsilon``,
            ``v_prediction`` or ``sample`` (ddpm), ``sample`` (two_step).
        num_train_timesteps: number of noise levels of ddpm.
        beta_schedule: spacing of the noise levels of ddpm, by diffusers' name.
        beta_start: first beta of a linear ``beta_schedule``.
        beta_end: last beta of a linear ``beta_schedule``.
        time_distribution: flow times seen in training: ``uniform``, ``beta`` (pi0: mostly noise) or
            ``logit_normal`` (mostly the middle).
        sampler: ``euler``, ``midpoint``, ``heun``, ``rk4`` (flow); ``ddim``, ``ddpm``, ``dpm++`` (ddpm).
        num_inference_steps: steps of the sampler; midpoint and Heun call the network twice in each, rk4 four
            times.
        timestep_spacing: which noise levels of ddpm the sampler visits, by diffusers' name; by default the
            one that suits the sampler.
        clip_sample: keep the estimate of the clean actions within plus or minus ``clip_sample_range``.
        clip_sample_range: limit of ``clip_sample`` [normalised units].
        clip_mode: whether a sampler's next step follows from the clipped estimate (``consistent``), or in
            part from the estimate before clipping, as LeRobot's ``ddim``.
        do_mask_loss_for_padding: leave steps behind the end of an episode out of the loss.
        unet_size: channels of ``unet1d``: S (64, 128, 256), M, L or XL (LeRobot's 512, 1024, 2048).
        down_dims: channels of ``unet1d`` at each resolution; wins over ``unet_size``.
        kernel_size: kernel size of the convolutions of ``unet1d``.
        n_groups: groups of the group normalisation of ``unet1d``.
        diffusion_step_embed_dim: width of the time embedding of ``unet1d``.
        use_film_scale_modulation: let the condition scale the features of ``unet1d``, not only shift them.
        actions_per_token: consecutive actions that make one token of ``mixer`` and ``dit``; divides
            ``horizon``. By default the most that last no longer than five control steps.
        dim_model: token width of ``mixer`` and ``dit``.
        n_layers: number of layers of ``mixer`` and ``dit``.
        n_heads: attention heads of ``dit``.
        dropout: dropout probability in ``mixer`` and ``dit``.
        spatial_softmax_num_keypoints: image keypoints per camera (``mixer`` and ``unet1d``).
        warm_start: what a new chunk takes over from the plan in execution: ``none``; ``noise_hold`` the noise
            of the steps that both cover; ``sdedit`` starts from the noised plan (Meng et al. 2022); ``rtc``
            guides towards it (real-time chunking, Black et al. 2025); ``prefix`` conditions on the actions
            that are executed meanwhile (Black et al. 2025b), which needs training with ``prefix_steps``.
        prefix_steps: train with up to so many given first actions [control steps].
        rtc_vjp: ``identity`` in place of the network's Jacobian, as LeRobot computes it, holds on to the plan
            whatever the network says; the paper's ``exact`` product moves only what the network is unsure of,
            and takes a backward pass.
        prefix_attention_schedule: how guidance fades over the plan, from the actions executed meanwhile on.
        max_guidance_weight: largest weight of the guidance of ``rtc``.
        sdedit_strength: fraction of the noise that the plan gets with ``sdedit``.
        rtc_config: settings of real-time chunking that ``lerobot-rollout`` passes; they win over the fields
            of ``rtc``.
        guidance_features: inputs that guidance may leave out, such as a goal; the instruction is one of them
            with ``language_dropout``.
        condition_dropout: how often training leaves out the ``guidance_features``.
        guidance_scale: w in ``x_without + w * (x_with - x_without)`` (classifier-free guidance, Ho and
            Salimans 2022); 1 is off.
        noise_seed: seed of the noise when acting; every episode of every environment has a stream of its own.

    Raises:
        ConfigurationError: on construction, naming the setting that cannot work.
    """

    choices = {  # noqa: RUF012  (ClassVar in the base)
        "objective": tuple(PROCESSES),
        "prediction_type": PREDICTION_TYPES,
        "beta_schedule": BETA_SCHEDULES,
    }

    presets = PRESETS
    preset: str = "base"

    objective: str = PRESET
    denoiser: str = one_of(DENOISERS, PRESET)
    n_obs_steps: int = PRESET
    horizon: int = PRESET
    align: Literal["current", "first_obs"] = PRESET
    execution: Mode = PRESET

    prediction_type: str = PRESET
    num_train_timesteps: int = 100
    beta_schedule: str = "squaredcos_cap_v2"
    beta_start: float = 0.0001
    beta_end: float = 0.02
    time_distribution: str = one_of(TIME_DISTRIBUTIONS, "beta")

    sampler: str = one_of(SAMPLER_NAMES, PRESET)
    num_inference_steps: int = PRESET
    timestep_spacing: Spacing | None = None
    clip_sample: bool = PRESET
    clip_sample_range: float = 1.0
    clip_mode: str = one_of(CLIP_MODES, PRESET)

    do_mask_loss_for_padding: bool = PRESET

    unet_size: str = one_of(SIZES, PRESET)
    down_dims: tuple[int, ...] = PRESET
    kernel_size: int = 5
    n_groups: int = 8
    diffusion_step_embed_dim: int = 128
    use_film_scale_modulation: bool = True

    actions_per_token: int = PRESET
    dim_model: int = 256
    n_layers: int = 4
    n_heads: int = 8
    dropout: float = 0.0
    spatial_softmax_num_keypoints: int = 32

    warm_start: WarmStart = "none"
    prefix_steps: int = 0
    rtc_vjp: Jacobian = "identity"
    prefix_attention_schedule: PrefixSchedule = "exp"
    max_guidance_weight: float = 5.0
    sdedit_strength: float = 0.5
    rtc_config: RTCConfig | None = None

    guidance_features: list[str] = field(default_factory=list)
    condition_dropout: float = 0.0
    guidance_scale: float = 1.0

    noise_seed: int = 0

    ema_max_value: float = 0.999
    optimizer_weight_decay: float = 1e-6

    def __post_init__(self) -> None:
        super().__post_init__()
        values = preset_values(self.preset, objective=self.objective, pretrained=self.starts_pretrained)
        values = {"n_obs_steps": 1, **values}
        aligned = (self.align or values["align"]) == "first_obs"
        self.resolve_seconds((self.n_obs_steps or values["n_obs_steps"]) - 1 if aligned else 0)
        self.fill_in(values)
        if self.down_dims is PRESET and self.unet_size in SIZES:
            self.down_dims = SIZES[self.unet_size]
        if self.actions_per_token is PRESET:
            most = max(1, 5 // self.chunk_stride)
            self.actions_per_token = max(n for n in range(1, most + 1) if self.horizon % n == 0)
        check(self)

    @property
    def length_name(self) -> str:
        """The field that says how many actions are predicted."""
        return "horizon"

    @property
    def timing(self) -> ChunkTiming:
        """Which steps are observed and predicted."""
        past = self.n_obs_steps - 1 if self.align == "first_obs" else 0
        if self.horizon <= past:
            raise ConfigurationError(
                f"horizon={self.horizon} ends before the current step: with align=first_obs and "
                f"n_obs_steps={self.n_obs_steps} it must be at least {past + 1}"
            )
        return ChunkTiming(self.n_obs_steps, self.horizon - past, self.chunk_stride, past)

    @property
    def prefix_tokens(self) -> int:
        """Longest prefix that training has shown [tokens]; a token is given as a whole."""
        return math.ceil(self.prefix_steps / (self.chunk_stride * self.actions_per_token))

    @property
    def process_settings(self) -> dict[str, Any]:
        """What the noising process is made from (`samplers.make_process`)."""
        own = {
            "ddpm": ("num_train_timesteps", "beta_schedule", "beta_start", "beta_end"),
            "flow": ("time_distribution",),
            "two_step": (),
        }
        return {name: getattr(self, name) for name in ("prediction_type", *own[self.objective])}

    @property
    def instruction_dropout(self) -> float:
        """None by itself: guidance has to leave out the instruction with its other features."""
        return 0.0

    @property
    def left_out(self) -> tuple[str, ...]:
        """What guidance may leave out: the ``guidance_features``, and the instruction if training does."""
        return (*self.guidance_features, *((INSTRUCTION,) if self.language_dropout else ()))

    @property
    def dropout_of_left_out(self) -> float:
        """How often training leaves it out, all together."""
        return self.condition_dropout or self.language_dropout

    def validate_features(self) -> None:
        """Check the inputs and outputs that LeRobot filled in from the dataset or the environment.

        Raises:
            FeatureError: naming what is missing or has an unusable shape.
        """
        super().validate_features()
        spec = self.feature_spec
        inputs = [*spec.vectors, *spec.images]
        for key in self.guidance_features:
            if key not in inputs:
                raise FeatureError(
                    f"guidance_features names {key!r}, but the inputs are: {', '.join(inputs)}"
                )
