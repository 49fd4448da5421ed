"""The whole comparison, from what is asked to the report."""

from pathlib import Path

from lerobot_act_chunking.diagnostics.compare.measuring import measure
from lerobot_act_chunking.diagnostics.compare.report import CompareReport
from lerobot_act_chunking.diagnostics.compare.settings import Settings
from lerobot_act_chunking.diagnostics.compare.trials import Trials
from lerobot_act_chunking.diagnostics.core.eval_info import read_outcomes


def diagnose(settings: Settings) -> CompareReport:
    """Which of the policies succeeds more often?

    Args:
        settings: what is asked.

    Raises:
        ConfigurationError: two have no episode in common.
        DatasetError: an evaluation is absent or damaged.
    """
    trials = [
        Trials(each.name, tuple(read_outcomes(Path(place)) for place in each.places))
        for each in settings.recipes
    ]
    return measure(trials, paired=settings.paired)
