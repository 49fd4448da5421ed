"""The whole diagnosis, from what is asked to the report."""

from typing import Any

from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.diagnostics.codebook.comparison.measuring import Watch, compare
from lerobot_act_chunking.diagnostics.codebook.comparison.report import ComparisonReport
from lerobot_act_chunking.diagnostics.codebook.measuring import measure
from lerobot_act_chunking.diagnostics.codebook.report import CodebookReport
from lerobot_act_chunking.diagnostics.codebook.settings import Settings
from lerobot_act_chunking.diagnostics.codebook.subject import find_data, load_subject
from lerobot_act_chunking.diagnostics.core.episodes import read_episodes
from lerobot_act_chunking.policies.vqbet_chunked.presets import preset_values


def diagnose(settings: Settings, watch: Watch = iter) -> CodebookReport | ComparisonReport:
    """What do a tokenizer's codes do; or, of a dataset, which tokenizer suits it?

    Args:
        settings: what is asked.
        watch: the tokenizers that are compared go through it, to show how far it is.

    Raises:
        ConfigurationError: there is no such checkpoint or file, or it has no codebook.
        DatasetError: the data are not here, are damaged, or too few.
        FeatureError: data of another robot.
    """
    if settings.compares:
        return _compare(settings, watch)
    subject = load_subject(settings.source)
    data = find_data(subject, settings.dataset)
    return measure(subject, *data, settings.thresholds, seed=settings.seed)


def _compare(settings: Settings, watch: Watch) -> ComparisonReport:
    usual = preset_values("base", tokenizer=None, pretrained=False)
    chosen: dict[str, Any] = {name: usual[name] if n is None else n for name, n in settings.sizes.items()}
    return compare(
        read_episodes(settings.source),
        ChunkTiming(1, **chosen),
        settings.thresholds,
        steps=settings.steps,
        seed=settings.seed,
        watch=watch,
    )
