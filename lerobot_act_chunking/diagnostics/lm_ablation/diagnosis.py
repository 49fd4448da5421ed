"""The whole comparison, from what is asked to the report."""

import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from lerobot_act_chunking.data.actions import require_dataset
from lerobot_act_chunking.data.quiet import quiet_missing_ffmpeg
from lerobot_act_chunking.diagnostics.core.digests import environment_identity
from lerobot_act_chunking.diagnostics.core.environments import environment_of
from lerobot_act_chunking.diagnostics.lm_ablation.cells import CELLS, REFERENCE, Cell
from lerobot_act_chunking.diagnostics.lm_ablation.corpus import Tokenizer
from lerobot_act_chunking.diagnostics.lm_ablation.laboratory import Laboratory
from lerobot_act_chunking.diagnostics.lm_ablation.matching import match
from lerobot_act_chunking.diagnostics.lm_ablation.measuring import measure
from lerobot_act_chunking.diagnostics.lm_ablation.pretraining import pretrain
from lerobot_act_chunking.diagnostics.lm_ablation.records import Store
from lerobot_act_chunking.diagnostics.lm_ablation.report import LmAblationReport
from lerobot_act_chunking.diagnostics.lm_ablation.settings import Settings
from lerobot_act_chunking.errors import DatasetError
from lerobot_act_chunking.json_files import read_json
from lerobot_act_chunking.nn.language.encoder import TextEncoderSpec
from lerobot_act_chunking.nn.language.weights import WEIGHTS, language_model_folder

Progress = Callable[[str, int, int], None]


def diagnose(settings: Settings, progress: Progress | None = None) -> LmAblationReport:
    """Does a language model's start help a policy's encoder, and which part of it?

    Trainings that the output folder holds are not repeated.

    Args:
        settings: what is asked.
        progress: called with what is being done and with the numbers done and planned.

    Raises:
        ConfigurationError: no language model, settings that cannot work, or another question's folder.
        DatasetError: no dataset, or a damaged one.
    """
    language_model = language_model_folder(settings.language_model, "act-chunking lm-ablation")
    laboratory = _open(settings, language_model)
    first = laboratory.policy(CELLS[REFERENCE], None, seed=0).policy
    spec: TextEncoderSpec = first.model.encoder.spec
    store = Store(settings.output_dir, _question(settings, laboratory, first.config, language_model))
    matched = match(spec)
    missing = [
        (cell, size, seed)
        for size in settings.sizes
        for seed in settings.seeds
        for cell in settings.chosen
        if laboratory.vocabulary or cell.init != "only_embeddings"  # nobody would read the words
        if not store.path(cell.name, size, seed).exists()
    ]
    starts = {
        cell: _weights(cell, settings, spec, language_model, progress)
        for cell in dict.fromkeys(cell for cell, *_ in missing)
    }
    for place, (cell, size, seed) in enumerate(missing):
        if progress is not None:
            progress(f"{cell.name}, {size} demonstrations, seed {seed}", place, len(missing))
        if not store.path(cell.name, size, seed).exists():  # another process may be at work, too
            store.keep(laboratory.train(cell, starts[cell], size, seed))
    return measure(settings, list(store.records()), matched)


def _open(settings: Settings, language_model: Path) -> Laboratory:
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata

    require_dataset(settings.dataset)
    quiet_missing_ffmpeg()
    path = Path(settings.dataset)
    try:
        meta = LeRobotDatasetMetadata(f"local/{path.name}", root=path)
    except Exception as error:  # whatever LeRobot and its parsers raise on damaged files
        raise DatasetError(f"the dataset at {path} cannot be read: {error!r}") from error
    tasks = [] if meta.tasks is None else list(map(str, meta.tasks.index))
    several = len(tasks) > 1
    tokenizer = Tokenizer(language_model, settings.text_tokens) if several else None
    if tokenizer is not None:
        tokenizer(tasks)
    laboratory = Laboratory(settings, meta, tokenizer, _vocabulary(language_model) if several else 0)
    laboratory.check()
    return laboratory


def _vocabulary(language_model: Path) -> int:
    return int(read_json(language_model / "config.json")["vocab_size"])


def _weights(
    cell: Cell,
    settings: Settings,
    spec: TextEncoderSpec,
    language_model: Path,
    progress: Progress | None,
) -> Path | None:
    """What a cell starts from."""
    if cell.init == "random":
        return None
    if cell.student is None:
        return language_model
    name = cell.student.name
    of_text = replace(
        spec,
        n_robot_tokens=0,
        vocabulary=_vocabulary(language_model),
        text_tokens=settings.text_tokens,
        dropout=0.0,
    )
    said = None if progress is None else lambda done, planned: progress(f"pretraining {name}", done, planned)
    folder, steps = settings.output_dir / "students", settings.budget.pretraining_steps
    return pretrain(cell.student, of_text, language_model, folder, steps, said)


def _question(
    settings: Settings, laboratory: Laboratory, config: Any, language_model: Path
) -> dict[str, Any]:
    """What every training depends on, beside its cell, size and seed."""
    with (language_model / WEIGHTS).open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    meta = laboratory.meta
    return {
        "dataset": {"episodes": meta.total_episodes, "frames": meta.total_frames},
        "environments": [
            environment_identity(environment_of(config, each)) for each in settings.conditions.values()
        ],
        "language_model": digest,
        "policy": {name: repr(value) for name, value in sorted(settings.policy.items())},
        "budget": vars(settings.budget),
        "held_out": settings.held_out,
        "text_tokens": settings.text_tokens,
        "seed": settings.seed,
    }
