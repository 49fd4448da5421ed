"""Which settings of `act_chunked` make sense together."""

from typing import TYPE_CHECKING

from lerobot.configs import NormalizationMode

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.heads.make import check_head
from lerobot_act_chunking.nn.latents.make import check_latent
from lerobot_act_chunking.policies.field_checks import check_fields
from lerobot_act_chunking.policies.multiples import check_divides, check_multiple
from lerobot_act_chunking.policies.prefix import check_prefix

if TYPE_CHECKING:
    from lerobot_act_chunking.policies.act_chunked.configuration_act_chunked import ActChunkedConfig

WITHIN_ONE = (NormalizationMode.MIN_MAX, NormalizationMode.QUANTILES, NormalizationMode.QUANTILE10)


def check(config: "ActChunkedConfig") -> None:
    """Refuse settings that cannot work.

    Raises:
        ConfigurationError: naming the value, the reason and the way out.
    """
    check_fields(config)
    config.check_backbone()
    check_divides(config, "chunk_size", "actions_per_query")
    check_divides(config, "dim_model", "n_heads", also=4)
    check_multiple(config, "dim_model", 4, "positions are sines and cosines of rows and columns")
    check_prefix(config)
    _check_encoder(config)
    _check_history(config)
    _check_likelihood(config)
    if config.use_vae:
        _check_latent(config)
    _check_sampling(config)


def _check_encoder(config: "ActChunkedConfig") -> None:
    asked = f"encoder_init={config.encoder_init}"
    if config.encoder_impl == "act":
        unused = {
            asked: config.encoder_init != "random",
            f"encoder_training={config.encoder_training}": config.encoder_training != "full",
            f"encoder_vocabulary={config.encoder_vocabulary}": config.encoder_vocabulary > 0,
            f"encoder_weights={config.encoder_weights}": config.encoder_weights is not None,
        }
        for setting in (each for each, is_set in unused.items() if is_set):
            raise ConfigurationError(f"{setting} is of language models: set --policy.encoder_impl=bert")
    elif config.encoder_init == "random" and config.encoder_weights is not None:
        raise ConfigurationError(
            f"encoder_weights={config.encoder_weights} has no use with encoder_init=random: set "
            "--policy.encoder_init=language_model, or leave the weights out"
        )
    elif config.encoder_impl == "mixer" and config.encoder_init != "random" and not config.encoder_weights:
        raise ConfigurationError(
            f"{asked}: mixers are language models only once pretrained by act-chunking lm-ablation: give "
            "--policy.encoder_weights"
        )
    if config.encoder_vocabulary and config.language_encoder is not None:
        raise ConfigurationError(
            f"encoder_vocabulary={config.encoder_vocabulary} reads the task in the encoder itself, and "
            f"language_encoder={config.language_encoder} beside it: leave one of them out"
        )
    if config.encoder_init == "only_embeddings" and not config.encoder_vocabulary:
        raise ConfigurationError(
            f"{asked} takes the word pieces, but the encoder reads none: set --policy.encoder_vocabulary"
        )


def _check_history(config: "ActChunkedConfig") -> None:
    if config.n_obs_steps > 1:
        if config.image_tokens == "summary":
            raise ConfigurationError(
                f"image_tokens=summary reads the current image alone, but n_obs_steps={config.n_obs_steps}: "
                "set --policy.n_obs_steps=1 or --policy.image_tokens=cells"
            )
        return
    for name in ("use_velocity", "history_dropout"):
        if getattr(config, name):
            raise ConfigurationError(
                f"{name}={getattr(config, name)} needs earlier observations: set --policy.n_obs_steps=2 "
                "or more"
            )


def _check_likelihood(config: "ActChunkedConfig") -> None:
    check_head(config.head_spec)
    mode = config.normalization_mapping["ACTION"]
    if config.bounded and mode not in WITHIN_ONE:
        raise ConfigurationError(
            f"action_likelihood={config.action_likelihood} predicts actions in [-1, 1], but actions are "
            f"normalised by {mode.value}: set the ACTION entry of normalization_mapping to MIN_MAX or "
            "QUANTILES"
        )


def _check_latent(config: "ActChunkedConfig") -> None:
    check_latent(config.latent_spec)
    if config.vae_action_stride > config.chunk_size:
        raise ConfigurationError(
            f"vae_action_stride={config.vae_action_stride} averages more actions than the chunk has "
            f"(chunk_size={config.chunk_size}): set vae_action_stride={config.chunk_size} or less"
        )
    if (config.z_hold == "steps") != (config.z_hold_steps > 0):
        held = config.z_hold == "steps"
        ways = "z_hold_steps=1 or more, or z_hold=episode" if held else "z_hold=steps, or z_hold_steps=0"
        raise ConfigurationError(
            f"z_hold={config.z_hold} and z_hold_steps={config.z_hold_steps} contradict each other: set {ways}"
        )
    mixes = config.z_inference == "sample" and config.z_hold != "episode"
    if mixes and config.execution_settings.execution == "ensemble" and not config.allow_mode_mixing:
        raise ConfigurationError(
            f"z_hold={config.z_hold} samples a new latent while execution=ensemble averages chunks of older "
            "ones, perhaps of different ways to act: set --policy.z_hold=episode, or "
            "--policy.allow_mode_mixing=true if that is what you want"
        )


def _check_sampling(config: "ActChunkedConfig") -> None:
    if config.execution_settings.execution != "coherence":
        return
    if not config.is_stochastic:
        raise ConfigurationError(
            "execution=coherence chooses among sampled chunks, but act_chunked predicts a single one: set "
            "--policy.use_vae=true --policy.z_inference=sample --policy.z_hold=chunk for latents, or "
            "--policy.action_likelihood=gaussian --policy.action_temperature=1 for actions"
        )
    if config.action_temperature == 0 and config.z_hold != "chunk":
        raise ConfigurationError(
            f"execution=coherence chooses anew among sampled chunks, z_hold={config.z_hold} keeps what was "
            "sampled: set --policy.z_hold=chunk"
        )
