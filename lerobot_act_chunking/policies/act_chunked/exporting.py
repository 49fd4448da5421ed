"""How `act_chunked` acts, for export."""

import math
from collections.abc import Mapping

from torch import Tensor

from act_chunking_runtime.draws import DrawSpec
from lerobot_act_chunking.data.batch import Observation
from lerobot_act_chunking.policies.act_chunked.draws import Draws
from lerobot_act_chunking.policies.act_chunked.modeling_act_chunked import ActChunkedPolicy
from lerobot_act_chunking.policies.exporting.acting import Acting

LATENT, CHOICES = "latent_draws", "action_draws"


def acting_of(policy: ActChunkedPolicy) -> Acting:
    """Chunks from the numbers that make a latent, and those by which the head samples."""
    config, network, draws = policy.config, policy.model, []
    n_samples = config.execution_settings.n_samples or 1
    if config.use_vae and config.z_inference == "sample" and network.latent is not None:
        hold = None if math.isinf(config.hold_steps) else config.hold_steps
        draws.append(DrawSpec(LATENT, (n_samples, network.latent.n_noise), "normal", hold))
    if network.head.draws_shape:
        draws.append(DrawSpec(CHOICES, (n_samples, *network.head.draws_shape), "uniform"))

    def chunks(window: Observation, drawn: Mapping[str, Tensor]) -> Tensor:
        numbers = Draws(drawn.get(LATENT), drawn.get(CHOICES))
        return policy._chunks(window, numbers, n_samples, config.n_action_steps)

    return Acting(chunks, draws)
