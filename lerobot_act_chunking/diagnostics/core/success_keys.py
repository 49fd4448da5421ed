"""Which member of a step's ``info`` says that an episode has succeeded, where it is not LeRobot's."""

from collections.abc import Collection, Sequence

from lerobot.envs.configs import EnvConfig

from lerobot_act_chunking.errors import ConfigurationError

IS_SUCCESS = "is_success"
"""By which LeRobot counts."""
OPTION = "--success-key"
Instead = Sequence[str] | None
"""What an episode's ``info`` named in place of the success key; None where the key was there."""

_ATTRIBUTE = "act_chunking_success_key"


def naming_success[C: EnvConfig](env_config: C, key: str | None) -> C:
    """The configuration with a key beside its fields, so that both come to every process together."""
    setattr(env_config, _ATTRIBUTE, key)
    return env_config


def success_key(env_config: EnvConfig) -> str:
    """The key that was named, or LeRobot's."""
    return getattr(env_config, _ATTRIBUTE, None) or IS_SUCCESS


def instead_of(env_config: EnvConfig, named: Collection[str]) -> Instead:
    """What an episode named in place of the success key.

    Args:
        env_config: of the environment.
        named: all members of the ``info`` of its steps.

    Returns:
        None where the key is among them, and where LeRobot's key was asked for: silence is no success then.
    """
    asked = getattr(env_config, _ATTRIBUTE, None)
    return None if asked == IS_SUCCESS or success_key(env_config) in named else sorted(named)


def never_said(env_config: EnvConfig, episodes: Sequence[Instead]) -> str | None:
    """In a sentence that no episode was ever called a success or none; None if one was.

    Args:
        env_config: of the environment.
        episodes: what each named in place of the key.
    """
    if not episodes or any(each is None for each in episodes):
        return None
    asked = getattr(env_config, _ATTRIBUTE, None)
    names = sorted({name for each in episodes for name in each or ()})
    key = success_key(env_config)
    told = f"the environment {env_config.type} never says info[{key!r}], so nothing is known of success: "
    if names:
        likely = next((name for name in names if "succ" in name.lower()), "NAME")
        told += f"it says {', '.join(names)}; name what means success, as {OPTION}={likely}"
    else:
        told += "it says nothing at all"
    return told if asked else f"{told}, or {OPTION}={IS_SUCCESS} if it speaks of successes alone"


def check_said(env_config: EnvConfig, episodes: Sequence[Instead]) -> None:
    """Refuse to go by successes of which nothing is known, where the environment says anything.

    Raises:
        ConfigurationError: as `never_said`.
    """
    sentence = never_said(env_config, episodes)
    if sentence is not None and any(episodes):
        raise ConfigurationError(sentence)
