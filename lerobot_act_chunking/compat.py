"""What differs between the LeRobots that this package runs with, and how each is told apart.

Written for 0.6.1, run against the sources of 0.6.2's development, and prepared for what 0.7 says of itself.
Every difference is found by looking for the thing itself, never by comparing versions. LeRobot is imported
inside the functions: this module must load with any of them, to say what does not fit.
"""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import fields
from types import ModuleType
from typing import Any

from lerobot_act_chunking.errors import ConfigurationError, FeatureError

TRACKERS = ("wandb", "trackio")
"""Options of ``lerobot-train`` that send metrics elsewhere; 0.7 has the second in place of the first."""


def action_of(output: Any) -> Any:
    """The actions in what a policy returned: all of it, or the ``action`` of 0.7's ``PolicyOutput``.

    Raises:
        FeatureError: a mapping without ``action``.
    """
    if not isinstance(output, Mapping):
        return output
    if "action" not in output:
        raise FeatureError(f"a policy returned a mapping without 'action', with: {', '.join(output)}")
    return output["action"]


def generates_text(policy: Any) -> bool:
    """Whether a policy generates text, too; no policy of 0.6.1 says so."""
    supported = getattr(policy, "supports_text_generation", None)
    return supported is not None and supported()


def trackers_off() -> list[str]:
    """Arguments of ``lerobot-train`` that keep its metrics on this machine."""
    from lerobot.configs.train import TrainPipelineConfig

    known = {field.name for field in fields(TrainPipelineConfig)}
    return [f"--{tracker}.enable=false" for tracker in TRACKERS if tracker in known]


def check_one_average(config: Any) -> None:
    """Refuse a training configuration in which LeRobot (``--ema.enable``) and the policy average the weights.

    Raises:
        ConfigurationError: naming both ways out.
    """
    theirs = getattr(getattr(config, "ema", None), "enable", False)
    if theirs and getattr(config.policy, "use_ema", False):
        raise ConfigurationError(
            "use_ema=true and --ema.enable=true would both average the weights: keep the policy's average "
            "(--ema.enable=false) or LeRobot's (--policy.use_ema=false)"
        )


def check_rtc_mode(rtc_config: Any, *, learned_prefixes: bool) -> None:
    """Refuse real-time chunking by training (``mode=trained``) with a policy that was not trained for it.

    Args:
        rtc_config: LeRobot's settings; those of 0.6.1 have no ``mode`` and mean ``guided``.
        learned_prefixes: the policy was trained to continue given actions.

    Raises:
        ConfigurationError: naming the mode that works.
    """
    mode = rtc_config is not None and rtc_config.enabled and getattr(rtc_config, "mode", "guided")
    if mode == "trained" and not learned_prefixes:
        raise ConfigurationError(
            "rtc mode=trained needs a policy that was trained to continue given actions (diffusion_chunked "
            "with --policy.prefix_steps, acting with warm_start=prefix); here use --inference.rtc.mode=guided"
        )


def model_card(policy: Any, *args: Any, dataset_meta: Any | None = None, **kwargs: Any) -> Any:
    """LeRobot's card of a policy: up to 0.6.1 the base class makes it, since then a function of training.

    Args:
        policy: whose card it is.
        args: what 0.6.1 passes to ``generate_model_card``.
        dataset_meta: of the training data.
        kwargs: as ``args``; of these the function takes ``cfg``.
    """
    from lerobot.policies.pretrained import PreTrainedPolicy

    method = getattr(PreTrainedPolicy, "generate_model_card", None)
    if method is not None:
        return method(policy, *args, dataset_meta=dataset_meta, **kwargs)
    make = inspect.unwrap(_training().generate_model_card)
    return make(policy.config, cfg=kwargs.get("cfg"), dataset_meta=dataset_meta)


def extend_model_cards(extend: Callable[[Any, Any, Any], Any]) -> None:
    """Let ``extend(card, config, dataset_meta)`` add to the cards that LeRobot makes outside of policies.

    Harmless when repeated. Nothing happens with 0.6.1, whose cards pass through the policy's own method.

    Raises:
        AttributeError: this LeRobot makes its cards in neither way.
    """
    from lerobot.policies.pretrained import PreTrainedPolicy

    if hasattr(PreTrainedPolicy, "generate_model_card"):
        return
    training = _training()
    make = inspect.unwrap(training.generate_model_card)

    def make_extended(model_cfg: Any, *args: Any, dataset_meta: Any | None = None, **kwargs: Any) -> Any:
        card = make(model_cfg, *args, dataset_meta=dataset_meta, **kwargs)
        return extend(card, model_cfg, dataset_meta)

    make_extended.__wrapped__ = make  # pyright: ignore[reportFunctionMemberAccess]
    vars(training)["generate_model_card"] = make_extended


def _training() -> ModuleType:
    from lerobot.common import train_utils

    return train_utils


def reader_incompatibility() -> str | None:
    """In what LeRobot's reader differs from the 0.6.1 whose insides fast chunks use; None if it fits."""
    try:
        from datasets import Dataset, List, Value  # noqa: F401  (columns are told apart by them)
        from lerobot.datasets.dataset_reader import DatasetReader
        from lerobot.datasets.factory import make_dataset  # noqa: F401
        from lerobot.datasets.lerobot_dataset import LeRobotDataset

        if hasattr(LeRobotDataset, "__getitems__"):
            return "LeRobotDataset has a __getitems__ of its own"
        used = {
            LeRobotDataset.__init__: ("reader", "writer"),
            DatasetReader.__init__: ("hf_dataset", "delta_indices", "_absolute_to_relative_idx", "_meta"),
            DatasetReader.get_item: (
                *("hf_dataset", "delta_indices"),
                *("_query_hf_dataset", "_get_query_timestamps", "_query_videos", "_image_transforms"),
            ),
            Dataset.__init__: ("_format_kwargs",),
        }
    except (ImportError, AttributeError) as error:
        return str(error)
    absent = [(code, name) for code, names in used.items() for name in names if not _uses(code, name)]
    return f"{absent[0][0].__qualname__} has no {absent[0][1]}" if absent else None


def _uses(function: Any, name: str) -> bool:
    return name in inspect.unwrap(function).__code__.co_names


def hub_incompatibility() -> str | None:
    """In what huggingface_hub differs from the 1.x whose requests can be routed; None if it fits."""
    try:
        import httpx  # noqa: F401
        from huggingface_hub import constants, set_client_factory  # noqa: F401
    except ImportError as error:
        return str(error)
    used = ("ENDPOINT", "HF_HUB_CACHE", "HF_HUB_DISABLE_XET")
    absent = [name for name in used if not hasattr(constants, name)]
    return f"huggingface_hub.constants has no {absent[0]}" if absent else None
