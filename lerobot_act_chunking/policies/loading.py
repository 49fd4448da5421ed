"""Loading any LeRobot checkpoint for use from Python."""

from pathlib import Path
from typing import Any, NamedTuple

from lerobot_act_chunking.errors import ConfigurationError


class LoadedPolicy(NamedTuple):
    """A policy in evaluation mode with the processors it was trained with."""

    policy: Any
    preprocessor: Any
    postprocessor: Any


def load_policy(path: str | Path) -> LoadedPolicy:
    """Load a checkpoint of any policy type, ours, LeRobot's or another plugin's.

    Args:
        path: checkpoint folder (``…/pretrained_model``) or repo id.

    Raises:
        ConfigurationError: the folder does not exist or holds no ``config.json``.
    """
    from lerobot.configs import PreTrainedConfig
    from lerobot.policies.factory import get_policy_class, make_pre_post_processors
    from lerobot.utils.import_utils import register_third_party_plugins

    register_third_party_plugins()
    path = str(path)
    check_checkpoint(path)
    config = PreTrainedConfig.from_pretrained(path)
    policy = get_policy_class(config.type).from_pretrained(path, config=config)
    policy.eval()
    device = {"device_processor": {"device": str(config.device)}}
    processors = make_pre_post_processors(config, pretrained_path=path, preprocessor_overrides=device)
    return LoadedPolicy(policy, *processors)


def check_checkpoint(path: str) -> None:
    """Refuse what is meant to be a folder and is no checkpoint, before LeRobot looks for it on the hub.

    Raises:
        ConfigurationError: the folder does not exist or holds no ``config.json``.
    """
    if Path(path).exists():
        if not (Path(path) / "config.json").exists():
            raise ConfigurationError(
                f"{path} holds no config.json; give a checkpoint's pretrained_model folder, "
                "for example outputs/train/checkpoints/last/pretrained_model"
            )
    elif path.startswith((".", "/", "~")) or path.count("/") != 1:
        raise ConfigurationError(f"there is no checkpoint at {path}")
