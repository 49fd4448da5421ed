"""The policy in question: a checkpoint of `act_chunked` with a latent."""

from dataclasses import dataclass
from typing import Any, cast

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.nn.latents.latent import Latent
from lerobot_act_chunking.policies.act_chunked.network import ActNetwork
from lerobot_act_chunking.policies.loading import LoadedPolicy, load_policy, read_config

POLICY_TYPE = "act_chunked"


@dataclass(frozen=True)
class Subject:
    """A policy with a latent.

    Attributes:
        checkpoint: its folder or repo id.
        loaded: the policy in evaluation mode, with its processors.
    """

    checkpoint: str
    loaded: LoadedPolicy

    @property
    def config(self) -> Any:
        """The policy's configuration."""
        return self.loaded.policy.config

    @property
    def network(self) -> ActNetwork:
        """The network that acts: the averaged one, if there is one."""
        policy = self.loaded.policy
        return policy.model if policy.ema is None else policy.ema.network

    @property
    def latent(self) -> Latent:
        """Its latent."""
        return cast("Latent", self.network.latent)


def load_subject(checkpoint: str) -> Subject:
    """Load a checkpoint that has a latent.

    Raises:
        ConfigurationError: there is no such checkpoint, or the policy has no latent.
    """
    config = read_config(checkpoint)
    if config.type == "temporal_ensemble":
        raise ConfigurationError(
            "a temporal_ensemble has no latent of its own: give the checkpoint it wraps, and wrap the result"
        )
    if config.type != POLICY_TYPE:
        raise ConfigurationError(
            f"{config.type} has no latent: give an {POLICY_TYPE} checkpoint (act-chunking import makes one "
            "of LeRobot's act)"
        )
    if not config.use_vae:  # pyright: ignore[reportAttributeAccessIssue]
        raise ConfigurationError(
            f"the policy at {checkpoint} was trained without a latent: train with --policy.use_vae=true"
        )
    return Subject(checkpoint, load_policy(checkpoint))
