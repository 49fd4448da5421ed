"""From a latent's name to the latent."""

from lerobot_act_chunking.errors import look_up
from lerobot_act_chunking.nn.latents.categorical import CategoricalLatent
from lerobot_act_chunking.nn.latents.conditional import ConditionalLatent
from lerobot_act_chunking.nn.latents.gaussian import GaussianLatent
from lerobot_act_chunking.nn.latents.latent import Latent
from lerobot_act_chunking.nn.latents.mixture import MixtureLatent
from lerobot_act_chunking.nn.latents.spec import LatentSpec

LATENTS: dict[str, type[Latent]] = {
    "gaussian": GaussianLatent,
    "conditional": ConditionalLatent,
    "mixture": MixtureLatent,
    "categorical": CategoricalLatent,
}
"""The latents. What is listed here can be asked for as ``latent_type``."""


def check_latent(spec: LatentSpec) -> None:
    """Refuse values that cannot work.

    Raises:
        ConfigurationError: naming the value and the way out.
    """
    look_up("latent_type", spec.latent_type, LATENTS)
    spec.check_values()


def make_latent(spec: LatentSpec, dim: int) -> Latent:
    """A fresh latent for a policy whose tokens have ``dim`` channels.

    Raises:
        ConfigurationError: naming a value that cannot work.
    """
    check_latent(spec)
    return LATENTS[spec.latent_type].from_spec(spec, dim)
