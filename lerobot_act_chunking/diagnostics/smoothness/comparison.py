"""Several sources measured alike."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from lerobot_act_chunking.diagnostics.smoothness.measuring import measure
from lerobot_act_chunking.diagnostics.smoothness.report import SmoothnessReport
from lerobot_act_chunking.diagnostics.smoothness.settings import EvaluationSpec
from lerobot_act_chunking.diagnostics.smoothness.sources import (
    holds_datasets,
    read_dataset,
    run_checkpoint,
)
from lerobot_act_chunking.errors import ConfigurationError, FeatureError

EVERY_CHECKPOINT = ("train", "checkpoints", "pretrained_model")


def compare(
    paths: Sequence[str],
    spec: EvaluationSpec,
    *,
    replan_interval: int | None = None,
    progress: Callable[[str, int], None] | None = None,
) -> list[SmoothnessReport]:
    """Measure checkpoints and datasets, all in units of the first one's action standard deviation.

    Args:
        paths: of checkpoints or datasets.
        spec: which episodes to run of checkpoints.
        replan_interval: control steps between the chunks behind the datasets' motion, if it was chunked.
        progress: called with a checkpoint's name and its number of finished episodes.

    Raises:
        ConfigurationError: a replan interval without a dataset; or see `run_checkpoint` and `read_dataset`.
        DatasetError: a folder with neither checkpoint nor dataset, or fewer than two episodes.
        FeatureError: the sources move different joints.
    """
    datasets = [holds_datasets(path) for path in paths]
    if replan_interval is not None and not any(datasets):
        raise ConfigurationError(
            f"replan_interval={replan_interval} is for datasets; a checkpoint's own setting decides for it"
        )
    names = source_names(paths)
    reports, first = [], None
    for path, name, dataset in zip(paths, names, datasets, strict=True):
        if dataset:
            source = read_dataset(path, replan_interval)
        else:
            source = run_checkpoint(path, spec, progress and partial(progress, name))
        first = first or replace(source, rollouts=[])
        if list(source.joint_names) != list(first.joint_names):
            raise FeatureError(
                f"{names[0]} moves {', '.join(first.joint_names)}; {name} "
                f"{', '.join(source.joint_names)}: only the same joints compare"
            )
        reports.append(
            measure(
                source.rollouts,
                action_std=first.action_std,
                joint_names=source.joint_names,
                latency_steps=source.latency_steps,
                name=name,
                knows_success=source.knows_success,
                floor=first.floor,
                notes=source.notes,
            )
        )
    return reports


def source_names(paths: Sequence[str]) -> list[str]:
    """As many of the last parts of each path as tell all apart, without those that every checkpoint has."""
    split = [[part for part in Path(path).parts if part not in EVERY_CHECKPOINT] or [path] for path in paths]
    names = list(paths)
    for count in range(1, max(map(len, split)) + 1):
        names = ["/".join(parts[-count:]) for parts in split]
        if len(set(names)) == len(names):
            break
    return names
