"""What has to be known about other policies to take their chunks from them: their configurations."""

import copy
import importlib
from pathlib import Path
from typing import Any

import draccus
from draccus.utils import DraccusException
from huggingface_hub import hf_hub_download
from huggingface_hub.constants import CONFIG_NAME, HF_HUB_OFFLINE
from lerobot.configs import PreTrainedConfig
from lerobot.utils.import_utils import register_third_party_plugins

from lerobot_act_chunking.errors import ConfigurationError, unknown_choice
from lerobot_act_chunking.json_files import read_json
from lerobot_act_chunking.nn.vision.torchvision_models import NAMES, cached_weights
from lerobot_act_chunking.policies.chunk_length import COUNTED_FROM_FIRST_OBSERVATION, chunk_length
from lerobot_act_chunking.policies.loading import check_checkpoint

WRAPPER = "temporal_ensemble"
DETERMINISTIC = ("act", "act_chunked")
"""Types that predict one and the same chunk for one observation."""

# Types without chunks that could be combined, and why.
_UNWRAPPABLE = {
    "gaussian_actor": "it predicts single actions, never a chunk",
    "lingbot_va": "its chunks go on from the frames and actions of those before, as only its own execution "
    "records them",
}

_NEEDLESS_DOWNLOADS = {"pretrained_backbone_weights": None, "load_vlm_weights": False}


def read_inner(path: str) -> dict[str, Any]:
    """The settings of the checkpoint at ``path`` (a folder or a repo id), to be continued from there.

    Raises:
        ConfigurationError: there is no such checkpoint.
    """
    check_checkpoint(path)
    try:
        file = Path(path) / CONFIG_NAME if Path(path).is_dir() else hf_hub_download(path, CONFIG_NAME)
        settings = read_json(Path(file))
        if not isinstance(settings, dict):
            raise ValueError(f"it holds {type(settings).__name__}, no settings")
    except (OSError, ValueError) as error:
        raise ConfigurationError(f"inner_path={path}: its {CONFIG_NAME} cannot be read: {error}") from error
    return {**settings, "pretrained_path": path}


def decode_inner(settings: dict[str, Any], **overrides: Any) -> PreTrainedConfig:
    """The configuration that ``settings`` (``type`` and any of its fields) describe.

    Raises:
        ConfigurationError: the type or a field is unknown, or cannot be wrapped.
    """
    settings = {**settings, **overrides}
    policy_type = settings.pop("type", None)
    if policy_type == WRAPPER:
        raise ConfigurationError(
            "the inner policy is itself a temporal_ensemble: load it with --policy.path and change its "
            "execution there, or name the policy that it wraps"
        )
    _check_known(policy_type)
    try:
        config = draccus.decode(PreTrainedConfig.get_choice_class(policy_type), settings)
    except (DraccusException, ConfigurationError, NotImplementedError) as error:
        reason = f"{error} {_root(error)}" if error.__cause__ else error
        raise ConfigurationError(f"settings of the inner policy ({policy_type}): {reason}") from error
    _check_wrappable(config)
    return config


def _root(error: BaseException) -> BaseException:
    return error if error.__cause__ is None else _root(error.__cause__)


def _check_known(policy_type: object) -> None:
    importlib.import_module("lerobot.policies")  # registers LeRobot's own types
    if policy_type not in PreTrainedConfig.get_known_choices():
        register_third_party_plugins()
    types = PreTrainedConfig.get_known_choices().keys() - {WRAPPER}
    if policy_type not in types:
        raise unknown_choice("type of inner policy", policy_type, sorted(types))


def _check_wrappable(config: PreTrainedConfig) -> None:
    reason = _UNWRAPPABLE.get(config.type)
    if reason is not None:
        raise ConfigurationError(
            f"policies of type {config.type} cannot be wrapped: {reason}. Use the policy without the wrapper"
        )
    if config.type == "tdmpc" and not config.use_mpc:  # pyright: ignore[reportAttributeAccessIssue]
        raise ConfigurationError(
            "use_mpc=False: the inner tdmpc then predicts single actions, and there are no chunks to "
            "execute. Set its use_mpc to true"
        )
    if config.use_peft:
        raise ConfigurationError(
            f"the inner {config.type} is a PEFT adapter: merge it into its base policy first"
        )
    if getattr(config, "use_relative_actions", False):
        raise relative_actions(config.type)


def relative_actions(policy_type: str) -> ConfigurationError:
    """The error for a policy whose chunks cannot be combined."""
    return ConfigurationError(
        f"the inner {policy_type} predicts actions relative to the robot's state: each chunk is anchored to "
        "another state, so overlapping chunks cannot be combined. Wrap a policy with absolute actions"
    )


def check_downloads(config: PreTrainedConfig) -> None:
    """Refuse a fresh inner policy whose image backbone would be downloaded where that is not allowed.

    Raises:
        ConfigurationError: ``HF_HUB_OFFLINE`` is set, and torch hub's cache does not have the weights.
    """
    weights = getattr(config, "pretrained_backbone_weights", None)
    backbone = getattr(config, "vision_backbone", None)
    if not HF_HUB_OFFLINE or weights is None or backbone not in NAMES or not config.image_features:
        return
    try:
        cached_weights(backbone, weights)
    except ConfigurationError as error:
        raise ConfigurationError(
            f"the inner {config.type} asks for pretrained_backbone_weights={weights}, which are not on this "
            "machine, and HF_HUB_OFFLINE is set: train it from scratch with "
            f"--policy.inner='{{type: {config.type}, pretrained_backbone_weights: null}}' (and its other "
            "settings), or wrap a checkpoint with --policy.inner_path"
        ) from error


def for_chunks(config: PreTrainedConfig, *, weights_follow: bool) -> PreTrainedConfig:
    """A copy of ``config`` whose policy hands out its longest chunks, as they are.

    Args:
        config: the inner policy's configuration.
        weights_follow: a checkpoint will fill the network, so pretrained parts need not be fetched.
    """
    config = copy.deepcopy(config)
    changes: dict[str, Any] = {}
    if config.type in COUNTED_FROM_FIRST_OBSERVATION:
        changes["n_action_steps"] = chunk_length(config)
    if config.type == "act":
        changes["temporal_ensemble_coeff"] = None
    if weights_follow:
        changes |= {name: value for name, value in _NEEDLESS_DOWNLOADS.items() if hasattr(config, name)}
    for name, value in changes.items():
        setattr(config, name, value)
    return config
