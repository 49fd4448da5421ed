"""How long the chunks of any policy are, ours or not."""

from lerobot.configs import PreTrainedConfig

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.chunked_config import ChunkedConfig

# What policies call their longest chunk; diffusion and multi_task_dit count it from their first observation.
_CHUNK_NAMES = ("chunk_size", "action_chunk_size", "action_horizon", "n_action_steps")
COUNTED_FROM_FIRST_OBSERVATION = ("diffusion", "multi_task_dit")


def chunk_length(config: PreTrainedConfig) -> int:
    """How many control steps the longest chunk covers that this policy can predict.

    Raises:
        ConfigurationError: its configuration does not say.
    """
    if isinstance(config, ChunkedConfig):
        return config.timing.control_steps
    if config.type in COUNTED_FROM_FIRST_OBSERVATION:
        return config.horizon - config.n_obs_steps + 1  # pyright: ignore[reportAttributeAccessIssue]
    if config.type == "tdmpc":  # its n_action_steps and n_action_repeats are its own execution
        return config.horizon  # pyright: ignore[reportAttributeAccessIssue]
    for name in _CHUNK_NAMES:
        length = getattr(config, name, None)
        if isinstance(length, int):
            return length
    raise ConfigurationError(
        f"policies of type {config.type} cannot be wrapped: their settings have none of "
        f"{', '.join(_CHUNK_NAMES)}, so they do not predict chunks of a known length"
    )
