"""The whole diagnosis, from what is asked to the report."""

from typing import Any

from lerobot_act_chunking.data.actions import is_dataset
from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.diagnostics.codebook.comparison.measuring import Watch, compare
from lerobot_act_chunking.diagnostics.codebook.comparison.report import ComparisonReport
from lerobot_act_chunking.diagnostics.codebook.measuring import measure
from lerobot_act_chunking.diagnostics.codebook.report import CodebookReport
from lerobot_act_chunking.diagnostics.codebook.settings import Settings
from lerobot_act_chunking.diagnostics.codebook.subject import find_data, load_subject
from lerobot_act_chunking.diagnostics.core.episodes import read_episodes
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.vqbet_chunked.presets import preset_values


def diagnose(settings: Settings, watch: Watch = iter) -> CodebookReport | ComparisonReport:
    """What do a tokenizer's codes do; or, of a dataset, which tokenizer suits it?

    Args:
        settings: what is asked.
        watch: the tokenizers that are compared go through it, to show how far it is.

    Raises:
        ConfigurationError: there is no such checkpoint or file, it has no codebook, or a setting is for the
            other kind of source.
        DatasetError: the data are not here, are damaged, or too few.
        FeatureError: data of another robot.
    """
    sizes = {"chunk_size": settings.chunk_size, "chunk_stride": settings.chunk_stride}
    if is_dataset(settings.source):
        _refuse({"dataset": settings.dataset}, "a checkpoint or a tokenizer file, and this is a dataset")
        return _compare(settings, sizes, watch)
    _refuse(sizes, "a dataset; these codes are for chunks of their own")
    subject = load_subject(settings.source)
    data = find_data(subject, settings.dataset)
    return measure(subject, *data, settings.thresholds, seed=settings.seed)


def _compare(settings: Settings, sizes: dict[str, int | None], watch: Watch) -> ComparisonReport:
    usual = preset_values("base", tokenizer=None, pretrained=False)
    chosen: dict[str, Any] = {name: usual[name] if n is None else n for name, n in sizes.items()}
    return compare(
        read_episodes(settings.source),
        ChunkTiming(1, **chosen),
        settings.thresholds,
        steps=settings.steps,
        seed=settings.seed,
        watch=watch,
    )


def _refuse(options: dict[str, Any], goes_with: str) -> None:
    for name, value in options.items():
        if value is not None:
            raise ConfigurationError(f"--{name.replace('_', '-')}={value} goes with {goes_with}")
