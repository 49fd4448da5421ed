"""How `vqbet_chunked` acts, for export."""

from collections.abc import Mapping

from torch import Tensor

from act_chunking_runtime.draws import DrawSpec
from lerobot_act_chunking.data.batch import Observation
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.exporting.acting import Acting
from lerobot_act_chunking.policies.vqbet_chunked.modeling_vqbet_chunked import VqbetChunkedPolicy

CODES = "code_draws"


def acting_of(policy: VqbetChunkedPolicy) -> Acting:
    """Chunks from the numbers that pick their codes.

    Raises:
        ConfigurationError: the policy has no codes yet.
    """
    if policy.tokenizer_phase.comes_first:
        raise ConfigurationError(
            f"the tokenizer of this checkpoint has not learned yet (training step "
            f"{policy.tokenizer_phase.n_learned}): train on, and export a later checkpoint"
        )
    config = policy.config
    shape = (config.execution_settings.n_samples or 1, 1, policy.tokenizer.n_codes)
    hold = None if config.code_hold == "episode" else 0

    def chunks(window: Observation, drawn: Mapping[str, Tensor]) -> Tensor:
        return policy._chunks(window, drawn[CODES], config.n_action_steps)

    return Acting(chunks, [DrawSpec(CODES, shape, "uniform", hold)])
