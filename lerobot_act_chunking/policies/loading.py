"""Loading any LeRobot checkpoint for use from Python."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from lerobot_act_chunking.errors import ActChunkingError, ConfigurationError

if TYPE_CHECKING:
    import numpy as np

CONFIG, WEIGHTS = "config.json", "model.safetensors"
PROCESSORS = ("policy_preprocessor.json", "policy_postprocessor.json")
FIRST_STATISTICS = ("normalize_inputs.", "normalize_targets.", "unnormalize_outputs.")
"""Where LeRobot kept statistics, among the weights, before it had processors."""
LONGEST_REASON = 400  # characters; PyTorch lists every weight that does not fit


class LoadedPolicy(NamedTuple):
    """A policy in evaluation mode with the processors it was trained with.

    Attributes:
        policy: LeRobot's policy object.
        preprocessor: normalises observations and moves them to the policy's device.
        postprocessor: turns predicted actions back into the robot's units.
    """

    policy: Any
    preprocessor: Any
    postprocessor: Any

    def reset(self) -> None:
        """Begin an episode: the policy drops the chunks and the history of the one before."""
        self.policy.reset()

    def act(self, observation: Mapping[str, Any], task: str | None = None) -> "np.ndarray":
        """The action (A,) of this control step, for one robot or one environment.

        Args:
            observation: what an environment of `make_env` returns: ``agent_pos`` (S,),
                ``environment_state`` (E,), ``pixels`` ``{camera: uint8 (height, width, 3)}``. Further arrays
                get the key ``observation.<name>``.
            task: the instruction, for policies that read one.
        """
        import torch
        from lerobot.envs.utils import preprocess_observation

        from lerobot_act_chunking.compat import action_of

        batch: dict[str, Any] = preprocess_observation(_batch_of_one(observation))
        if task is not None:
            batch["task"] = [task]
        with torch.inference_mode():
            action = action_of(self.policy.select_action(self.preprocessor(batch)))
            return self.postprocessor(action)[0].to("cpu").numpy()


def _batch_of_one(observation: Mapping[str, Any]) -> dict[str, Any]:
    return {
        key: _batch_of_one(value) if isinstance(value, Mapping) else value[None]
        for key, value in observation.items()
    }


def load_policy(path: str | Path, settings: Sequence[str] = ()) -> LoadedPolicy:
    """Load a checkpoint of any policy type, ours, LeRobot's or another plugin's.

    Args:
        path: checkpoint folder (``…/pretrained_model``) or repo id.
        settings: to change in it, as in ``n_action_steps=10``.

    Raises:
        ConfigurationError: there is no checkpoint, or a file of it is missing or damaged.
    """
    from lerobot.policies.factory import get_policy_class, make_pre_post_processors

    path = str(path)
    config = read_config(path, settings)
    check_complete(path, config.type)
    with explained(path):
        policy = get_policy_class(config.type).from_pretrained(path, config=config)
        policy.eval()
        device = {"device_processor": {"device": str(config.device)}}
        processors = make_pre_post_processors(config, pretrained_path=path, preprocessor_overrides=device)
    return LoadedPolicy(policy, *processors)


def read_config(path: str, settings: Sequence[str] = ()) -> Any:
    """The configuration of a LeRobot checkpoint of any type, ours or not.

    Args:
        path: checkpoint folder or repo id.
        settings: to change in it, as in ``n_action_steps=10``.

    Raises:
        ConfigurationError: there is no checkpoint, its configuration cannot be read, or a setting cannot
            work.
    """
    from lerobot.configs import PreTrainedConfig
    from lerobot.utils.import_utils import register_third_party_plugins

    register_third_party_plugins()
    check_checkpoint(path)
    with explained(path):
        try:
            return PreTrainedConfig.from_pretrained(path, cli_overrides=[f"--{each}" for each in settings])
        except SystemExit as error:  # argparse's way to refuse an option; it has printed the reason
            given = ", ".join(f"--policy.{each}" for each in settings)
            raise ConfigurationError(f"{path} does not take {given}") from error


def check_checkpoint(path: str) -> None:
    """Refuse what is meant to be a folder and is no checkpoint, before LeRobot looks for it on the hub.

    Raises:
        ConfigurationError: the folder does not exist or holds no ``config.json``.
    """
    if Path(path).exists():
        if not (Path(path) / CONFIG).is_file():
            raise ConfigurationError(
                f"{path} holds no {CONFIG}; give a checkpoint's pretrained_model folder, "
                "for example outputs/train/checkpoints/last/pretrained_model"
            )
    elif path.startswith((".", "/", "~")) or path.count("/") != 1:
        raise ConfigurationError(f"there is no checkpoint at {path}")


def check_complete(path: str, policy_type: str) -> None:
    """Refuse a checkpoint's folder that lacks weights or processors; repositories are left to the hub.

    Raises:
        ConfigurationError: naming the file, and the way to it.
    """
    folder = Path(path)
    if not folder.is_dir():
        return
    if not (folder / WEIGHTS).is_file():
        adapter = (folder / "adapter_model.safetensors").is_file()
        hint = "it is an adapter: merge it into its policy first" if adapter else _COPY_AGAIN
        raise ConfigurationError(f"{path} holds no {WEIGHTS}; {hint}")
    missing = [name for name in PROCESSORS if not (folder / name).is_file()]
    if missing:
        way = _way_to_processors(folder, policy_type) if len(missing) == len(PROCESSORS) else _COPY_AGAIN
        raise ConfigurationError(f"{path} holds no {missing[0]}; {way}")


_COPY_AGAIN = "copy the whole folder from where the checkpoint was trained or published"


def _way_to_processors(folder: Path, policy_type: str) -> str:
    if policy_type == "act":
        needed = "" if _holds_statistics(folder) else " --dataset <the dataset it was trained on>"
        return (
            "make an act_chunked checkpoint that has them: "
            f"act-chunking import {folder} --out <folder>{needed}"
        )
    if _holds_statistics(folder):
        return (
            "it is from before LeRobot had processors: python -m lerobot.processor."
            f"migrate_policy_normalization --pretrained-path {folder} --output-dir {folder}_migrated"
        )
    return _COPY_AGAIN


def _holds_statistics(folder: Path) -> bool:
    from safetensors import safe_open

    with explained(str(folder)), safe_open(folder / WEIGHTS, "pt") as file:
        return any(name.startswith(FIRST_STATISTICS) for name in file.keys())  # noqa: SIM118 (no mapping)


@contextmanager
def explained(path: str) -> Iterator[None]:
    """Turn what goes wrong while a checkpoint is read into one line; the original error stays its cause.

    Damaged files raise whatever json, draccus, safetensors or PyTorch come upon.

    Raises:
        ConfigurationError: naming the checkpoint and the reason.
    """
    try:
        yield
    except ActChunkingError:
        raise
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        if len(reason) > LONGEST_REASON:
            reason = f"{reason[:LONGEST_REASON]} ..."
        what = (
            "the checkpoint" if Path(path).exists() else "there is no folder of this name, and the repository"
        )
        raise ConfigurationError(f"{path}: {what} cannot be loaded: {reason}") from error
