"""Which settings of `vqbet_chunked` make sense together."""

from typing import TYPE_CHECKING

from lerobot.configs import NormalizationMode

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.field_checks import check_fields
from lerobot_act_chunking.policies.multiples import check_divides
from lerobot_act_chunking.policies.prefix import check_prefix
from lerobot_act_chunking.tokenizers.make import TOKENIZERS, check_tokenizer
from lerobot_act_chunking.tokenizers.spec import TokenizerSpec

if TYPE_CHECKING:
    from lerobot_act_chunking.policies.vqbet_chunked.configuration_vqbet_chunked import VqbetChunkedConfig

WITHIN_ONE = (NormalizationMode.MIN_MAX, NormalizationMode.QUANTILES, NormalizationMode.QUANTILE10)

MOST_ACTIONS = 10**6  # in a sample; a batch of 64 with 32 dimensions is 8 GB


def check(config: "VqbetChunkedConfig") -> None:
    """Refuse settings that cannot work.

    Raises:
        ConfigurationError: naming the value, the reason and the way out.
    """
    check_fields(config)
    config.check_backbone()
    check_divides(config, "gpt_hidden_dim", "gpt_n_head")
    check_prefix(config)
    _check_queries(config)
    _check_tokenizer(config)
    _check_offsets(config)
    _check_sampling(config)


def _check_queries(config: "VqbetChunkedConfig") -> None:
    n_chunks, size = config.queries.n_queries, config.chunk_size
    if n_chunks * size > MOST_ACTIONS:
        raise ConfigurationError(
            f"n_obs_steps={config.n_obs_steps} and n_action_pred_token={config.n_action_pred_token} make "
            f"{n_chunks} chunks of chunk_size={size}, {n_chunks * size} actions in each sample, more than "
            f"{MOST_ACTIONS}: set --policy.chunk_size to {MOST_ACTIONS // n_chunks} or less"
        )


def _check_tokenizer(config: "VqbetChunkedConfig") -> None:
    check_tokenizer(TokenizerSpec.from_fields(config, chunk_size=config.chunk_size, action_dim=1))
    kind = TOKENIZERS[config.tokenizer]
    mode = config.normalization_mapping["ACTION"]
    if kind.is_bounded and mode not in WITHIN_ONE:
        raise ConfigurationError(
            f"tokenizer={config.tokenizer} has bins in [-1, 1], but actions are normalised by {mode.value}: "
            "set the ACTION entry of normalization_mapping to MIN_MAX or QUANTILES"
        )
    joint = config.tokenizer_training == "joint"
    if joint and config.tokenizer_path is not None:
        raise ConfigurationError(
            f"tokenizer_training=joint would change the tokenizer of tokenizer_path={config.tokenizer_path}, "
            "which is frozen: leave one of them out"
        )
    if joint and not kind.is_learned:
        learned = (f"tokenizer={name}" for name, each in TOKENIZERS.items() if each.is_learned)
        raise ConfigurationError(
            f"tokenizer={config.tokenizer} has nothing to learn, but tokenizer_training is joint: set "
            f"{' or '.join(learned)}, or tokenizer_training=in_loop"
        )
    if joint and config.use_ema:
        raise ConfigurationError(
            "tokenizer_training=joint moves the codes while use_ema averages what predicts them, so that "
            "they no longer fit: set --policy.use_ema=false"
        )


def _check_offsets(config: "VqbetChunkedConfig") -> None:
    if config.offset_mode == "table" and not TOKENIZERS[config.tokenizer].is_learned:
        raise ConfigurationError(
            f"offset_mode=table holds a whole chunk for every value of every code, far too many with "
            f"tokenizer={config.tokenizer}: set offset_mode=code_conditioned"
        )


def _check_sampling(config: "VqbetChunkedConfig") -> None:
    if config.execution_settings.execution != "coherence":
        return
    if config.bet_softmax_temperature == 0:
        raise ConfigurationError(
            "execution=coherence chooses among sampled chunks, but bet_softmax_temperature=0 gives a single "
            "one: set bet_softmax_temperature=1, or execution=crossfade"
        )
    if config.code_hold == "episode":
        raise ConfigurationError(
            "execution=coherence chooses anew among sampled chunks, code_hold=episode chooses once: set "
            "code_hold=chunk, or execution=crossfade"
        )
