"""Which settings of `diffusion_chunked` make sense together."""

from typing import TYPE_CHECKING

from lerobot_act_chunking.compat import check_rtc_mode
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.nn.denoisers.make import DENOISERS
from lerobot_act_chunking.policies.field_checks import check_fields
from lerobot_act_chunking.policies.multiples import check_divides, check_multiple
from lerobot_act_chunking.sampling.process import PROCESSES
from lerobot_act_chunking.sampling.samplers import check_sampler

if TYPE_CHECKING:
    from lerobot_act_chunking.policies.diffusion_chunked.configuration_diffusion_chunked import (
        DiffusionChunkedConfig,
    )

MOST_HALVINGS = 9  # of a horizon, to a handful of steps


def check(config: "DiffusionChunkedConfig") -> None:
    """Refuse settings that cannot work.

    Raises:
        ConfigurationError: naming the value, the reason and the way out.
    """
    check_fields(config)
    config.check_backbone()
    _check_horizon(config)
    _check_denoiser(config)
    _check_sampling(config)
    _check_warm_start(config)
    _check_guidance(config)
    check_rtc_mode(config.rtc_config, learned_prefixes=config.warm_start == "prefix")


def _check_horizon(config: "DiffusionChunkedConfig") -> None:
    timing = config.timing
    if timing.past_steps and config.chunk_stride > 1:
        raise ConfigurationError(
            f"chunk_stride={config.chunk_stride} needs align=current, because observations are one control "
            "step apart and predicted actions are not: set align=current, or chunk_stride=1"
        )
    if config.n_action_steps > timing.control_steps:
        needed = (config.n_action_steps - 2) // config.chunk_stride + 2 + timing.past_steps
        raise ConfigurationError(
            f"horizon={config.horizon} covers {timing.control_steps} control steps from now on, fewer than "
            f"n_action_steps={config.n_action_steps}: "
            f"set horizon={needed} or more, or n_action_steps={timing.control_steps}"
        )
    settings = config.execution_settings
    if settings.execution == "coherence" and config.objective == "two_step":
        raise ConfigurationError(
            "execution=coherence chooses among sampled chunks, but objective=two_step predicts a single one: "
            "set execution=crossfade, or objective=flow"
        )


def _check_denoiser(config: "DiffusionChunkedConfig") -> None:
    if config.denoiser == "dit":
        check_divides(config, "dim_model", "n_heads", also=4)
    if config.denoiser == "unet1d":
        _check_unet(config)
    else:
        check_divides(config, "horizon", "actions_per_token")
        check_multiple(config, "dim_model", 4, "positions are sines and cosines of rows and columns")


def _check_unet(config: "DiffusionChunkedConfig") -> None:
    n_halvings = len(config.down_dims) - 1
    if not 0 <= n_halvings <= MOST_HALVINGS:
        raise ConfigurationError(
            f"down_dims={tuple(config.down_dims)} must have 1 to {MOST_HALVINGS + 1} levels of a unet1d"
        )
    halved = f"a unet1d with down_dims={tuple(config.down_dims)} halves it {n_halvings} times"
    check_multiple(config, "horizon", 2**n_halvings, halved)
    for channels in config.down_dims:
        if channels % config.n_groups:
            raise ConfigurationError(
                f"down_dims={tuple(config.down_dims)} must be multiples of n_groups={config.n_groups}"
            )
    if config.kernel_size % 2 == 0:
        raise ConfigurationError(
            f"kernel_size={config.kernel_size} must be odd, to keep the horizon's length"
        )


def _check_sampling(config: "DiffusionChunkedConfig") -> None:
    allowed = PROCESSES[config.objective].prediction_types
    if config.prediction_type not in allowed:
        raise ConfigurationError(
            f"prediction_type={config.prediction_type} does not go with objective={config.objective}: "
            f"set {' or '.join(f'prediction_type={name}' for name in allowed)}"
        )
    check_sampler(
        config.objective,
        config.sampler,
        config.num_inference_steps,
        num_train_timesteps=config.num_train_timesteps,
        spacing=config.timestep_spacing,
        clip_mode=config.clip_mode,
    )


def _check_warm_start(config: "DiffusionChunkedConfig") -> None:
    start, settings = config.warm_start, config.execution_settings
    if start != "none" and config.timing.past_steps:
        raise ConfigurationError(
            f"warm_start={start} needs align=current, because a plan has no past: set align=current, or "
            "warm_start=none"
        )
    if start not in ("none", "prefix") and config.objective == "two_step":
        raise ConfigurationError(
            f"warm_start={start} changes how noise becomes actions, but objective=two_step uses none: "
            "set warm_start=none, or objective=flow"
        )
    if (config.prefix_steps or start == "prefix") and not DENOISERS[config.denoiser].per_token_time:
        able = sorted(f"denoiser={name}" for name, kind in DENOISERS.items() if kind.per_token_time)
        raise ConfigurationError(
            f"prefix conditioning gives each token its own time, which {config.denoiser} cannot: "
            f"set {' or '.join(able)}"
        )
    if start == "prefix" and settings.latency_steps > config.prefix_steps:
        raise ConfigurationError(
            f"warm_start=prefix with latency_steps={settings.latency_steps} needs a policy trained with "
            f"prefix_steps of at least as much, not {config.prefix_steps}"
        )
    if start == "prefix" and not config.prefix_steps:
        raise ConfigurationError(
            "warm_start=prefix needs a policy trained with prefix_steps > 0: set warm_start=none, or "
            "train one with prefix_steps=4"
        )
    if config.prefix_tokens * config.actions_per_token >= config.horizon:
        raise ConfigurationError(
            f"prefix_steps={config.prefix_steps} leaves nothing to predict: a chunk covers "
            f"{config.timing.control_steps} control steps"
        )
    if start == "noise_hold" and settings.execution == "coherence":
        raise ConfigurationError(
            "warm_start=noise_hold gives all samples of a step the same noise: execution=coherence would "
            "have nothing to choose from: set warm_start=none, or execution=crossfade"
        )
    overlapping = settings.replan_interval < settings.n_action_steps
    if start == "noise_hold" and overlapping and settings.replan_interval % config.chunk_stride:
        raise ConfigurationError(
            f"warm_start=noise_hold moves noise from one chunk to the next by whole predictions: "
            f"replan_interval={settings.replan_interval} must be a multiple of "
            f"chunk_stride={config.chunk_stride}"
        )


def _check_guidance(config: "DiffusionChunkedConfig") -> None:
    if config.condition_dropout and not config.guidance_features:
        raise ConfigurationError(
            f"condition_dropout={config.condition_dropout} leaves out guidance_features, but none are named: "
            "set condition_dropout=0, or name them"
        )
    if config.condition_dropout and config.language_dropout not in (0, config.condition_dropout):
        raise ConfigurationError(
            f"condition_dropout={config.condition_dropout} and language_dropout={config.language_dropout} "
            "differ, but guidance leaves out both at once: set them to the same"
        )
    if config.guidance_scale != 1 and not config.dropout_of_left_out:
        raise ConfigurationError(
            f"guidance_scale={config.guidance_scale} needs a policy trained with condition_dropout > 0 (or "
            "language_dropout > 0): set guidance_scale=1"
        )
