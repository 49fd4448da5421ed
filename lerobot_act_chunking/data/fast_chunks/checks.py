"""What to say if there is no dataset to train on."""

import functools
from collections.abc import Callable
from pathlib import Path

import httpx
from huggingface_hub.errors import LocalEntryNotFoundError, OfflineModeIsEnabled
from lerobot.configs.train import TrainPipelineConfig
from lerobot.utils.constants import HF_LEROBOT_HOME

from lerobot_act_chunking.compat import check_one_average
from lerobot_act_chunking.data.fast_chunks.reading import begin_run, is_ours
from lerobot_act_chunking.data.missing_files import what_is_missing
from lerobot_act_chunking.errors import ConfigurationError, DatasetError
from lerobot_act_chunking.nn.processes import is_distributed

HUB_ERRORS = (httpx.HTTPError, OfflineModeIsEnabled, LocalEntryNotFoundError)
"""What LeRobot raises if a dataset is neither on this machine nor on a hub that it can reach."""


def with_checks[Dataset](
    make_dataset: Callable[[TrainPipelineConfig], Dataset],
) -> Callable[[TrainPipelineConfig], Dataset]:
    """LeRobot's ``make_dataset``, with errors that name the cause, for this package's policies alone.

    Only training comes through it. Datasets that are merely opened, to be looked at or mended, are not
    checked; nor are those that LeRobot's own policies train on.

    Returns:
        The same function, except that it raises a ``DatasetError`` if there is no dataset, and a
        ``ConfigurationError`` if it could not be read in this way.
    """

    @functools.wraps(make_dataset)
    def make_checked_dataset(cfg: TrainPipelineConfig) -> Dataset:
        begin_run(cfg)
        if not is_ours(cfg.trainable_config):
            return make_dataset(cfg)
        check_one_average(cfg)
        _check_streaming(cfg)
        try:
            return make_dataset(cfg)
        except HUB_ERRORS as error:
            # "from None": the hub client's chain of tracebacks would bury the message, which quotes it.
            raise _absent(cfg.dataset.repo_id, cfg.dataset.root, error) from None

    return make_checked_dataset


def _check_streaming(cfg: TrainPipelineConfig) -> None:
    """Refuse streams that LeRobot and accelerate cannot divide."""
    if not cfg.dataset.streaming:
        return
    if not cfg.num_workers:
        raise ConfigurationError(
            "--dataset.streaming=true reads nothing with --num_workers=0, since LeRobot divides the dataset "
            "among its worker processes: set --num_workers=1 or more"
        )
    if is_distributed():
        raise ConfigurationError(
            "--dataset.streaming=true trains in one process alone: accelerate cannot divide batches with "
            "text in them, as LeRobot's have (the task): leave streaming out, or start one process"
        )


def _absent(repo_id: str, root: str | None, error: Exception) -> DatasetError:
    folder = Path(root) if root else HF_LEROBOT_HOME / repo_id
    reason = str(error).strip().splitlines()[0]
    way_out = (  # nothing is recorded into a folder that may be somebody's
        "Name a LeRobotDataset's folder with --dataset.root, or copy what is missing into this one"
        if folder.exists()
        else f"Record one: act-chunking record --task transfer_cube --repo-id {repo_id} --root {folder}"
    )
    return DatasetError(
        f"{folder} {what_is_missing(folder)}, and {repo_id!r} could not be fetched from the Hugging Face hub "
        f"({reason}). {way_out}"
    )
