"""What a checkpoint says of its training: the data, the control rate, and whether it has learned anything."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.json_files import read_json

UNTRAINED = (
    "the policy at {checkpoint} is untrained (its weights are still the initial ones), so that this says "
    "nothing about a trained one: give a checkpoint of lerobot-train"
)
HARDLY_LEARNED = (
    "the policy at {checkpoint} has hardly learned: on the demonstrations it is off by {error:.2g} (mean "
    "absolute error, normalised units), by as much as {baseline:.2g} if it always did their mean action, so "
    "that this says little about a trained one: train for longer"
)
_HARDLY = 0.8  # of the mean action's error; what has learned is well below
_FLOATS = {"F64", "F32", "F16", "BF16"}


@dataclass(frozen=True)
class Training:
    """The training configuration beside a checkpoint.

    Attributes:
        folder: of the dataset; None if it is not known.
        episodes: those that were used; None for all.
        fps: control steps per second of the data; None if it is not known.
    """

    folder: str | None = None
    episodes: list[int] | None = None
    fps: float | None = None


def read_training(checkpoint: str, config: Any = None) -> Training:
    """What a checkpoint's folder and configuration say; nothing is downloaded.

    The rate is the one that the policy's configuration holds, or that of the dataset, as far as it is here.

    Args:
        checkpoint: folder or repo id.
        config: the policy's configuration, if it has been read.

    Raises:
        ConfigurationError: a ``train_config.json`` that is no training configuration.
    """
    from lerobot.utils.constants import HF_LEROBOT_HOME

    path = Path(checkpoint) / "train_config.json"
    own = getattr(config, "fps", None) or getattr(getattr(config, "trained_on", None), "fps", None)
    if not path.is_file():
        return Training(fps=own)
    try:
        dataset = read_json(path)["dataset"]
        folder = dataset.get("root") or str(HF_LEROBOT_HOME / dataset["repo_id"])
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ConfigurationError(
            f"{path} is no training configuration of lerobot-train ({error!r}): remove it, or restore it"
        ) from error
    return Training(folder, dataset.get("episodes"), own or dataset_fps(folder))


def dataset_fps(folder: str | Path | None) -> float | None:
    """Control steps per second of a LeRobotDataset; None if there is none."""
    fps = _info(folder).get("fps")
    return float(fps) if isinstance(fps, int | float) and fps > 0 else None


def dataset_features(folder: str | Path | None) -> dict[str, Any]:
    """The features of a LeRobotDataset; none if there is no dataset."""
    features = _info(folder).get("features")
    return features if isinstance(features, dict) else {}


def _info(folder: str | Path | None) -> dict[str, Any]:
    """Whoever needs the dataset itself says what is wrong with it."""
    try:
        info = read_json(Path(folder) / "meta" / "info.json") if folder else {}
    except (OSError, ValueError):
        return {}
    return info if isinstance(info, dict) else {}


def untrained(checkpoint: str) -> str | None:
    """The sentence that says so, if a checkpoint's weights are the ones that every network begins with.

    Normalisation layers begin with a scale of exactly 1, the last layers of denoisers with weights of
    exactly 0; one step of training changes them. Image backbones, which may be loaded and frozen, do not
    count.

    Args:
        checkpoint: a folder; of a repo id nothing is known.
    """
    from safetensors import SafetensorError

    file = Path(checkpoint) / "model.safetensors"
    try:
        return UNTRAINED.format(checkpoint=checkpoint) if file.is_file() and _is_initial(file) else None
    except SafetensorError:  # a wrapped policy's, or damaged: whoever loads it says so
        return None


def hardly_learned(checkpoint: str, error: float, baseline: float) -> str | None:
    """The sentence that says so, if a policy knows hardly more of its demonstrations than their mean action.

    Args:
        checkpoint: its name.
        error: mean absolute error on the demonstrations [normalised units].
        baseline: the same of their mean action.
    """
    if error <= _HARDLY * baseline:
        return None
    return HARDLY_LEARNED.format(checkpoint=checkpoint, error=error, baseline=baseline)


def _is_initial(file: Path) -> bool:
    """Whether all scales are 1; or, without any, whether a matrix is 0."""
    from safetensors import safe_open

    with safe_open(file, "pt") as tensors:
        learned = [
            name
            for name in tensors.keys()  # noqa: SIM118  (no mapping)
            if name.endswith("weight")
            and "backbone" not in name
            and tensors.get_slice(name).get_dtype() in _FLOATS
        ]
        rank = {name: len(tensors.get_slice(name).get_shape()) for name in learned}
        scales = [name for name in learned if rank[name] == 1]
        if scales:
            return all(bool((tensors.get_tensor(name) == 1).all()) for name in scales)
        return any(not tensors.get_tensor(name).any() for name in learned if rank[name] > 1)
