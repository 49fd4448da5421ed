"""A checkpoint, and the environment in which it acts."""

from dataclasses import dataclass
from typing import Any

from lerobot.envs.configs import EnvConfig

from lerobot_act_chunking.diagnostics.core.environments import EnvironmentSpec, action_names, environment_of
from lerobot_act_chunking.policies.loading import check_complete, read_config


@dataclass(frozen=True)
class Subject:
    """What is evaluated.

    Attributes:
        checkpoint: folder or repo id.
        config: the policy's.
        env_config: of the environment that shows what this policy observes.
        action_names: a name for each number of an action.
    """

    checkpoint: str
    config: Any
    env_config: EnvConfig
    action_names: tuple[str, ...]

    @property
    def dt(self) -> float:
        """Control period [s]."""
        return 1 / self.env_config.fps


def read_subject(checkpoint: str, environment: EnvironmentSpec) -> Subject:
    """A checkpoint in an environment; no weights are read.

    Raises:
        ConfigurationError: no complete checkpoint, or options that the environment refuses.
        FeatureError: another robot's policy, or one for another control rate.
    """
    config = read_config(checkpoint)
    check_complete(checkpoint, config.type)
    env_config = environment_of(config, environment, checkpoint)
    (width,) = config.action_feature.shape
    return Subject(checkpoint, config, env_config, action_names(env_config, width, checkpoint))
