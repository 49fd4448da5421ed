"""Everything the comparison found, as one object: the command prints it, JSON holds it, plots draw it."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

from lerobot_act_chunking.diagnostics.compare.trials import Contrast, Trials
from lerobot_act_chunking.diagnostics.compare.verdict import LEVEL
from lerobot_act_chunking.diagnostics.core.report import Report


@dataclass(frozen=True, kw_only=True)
class CompareReport(Report):
    """The answer to: which succeeds more often?

    Attributes:
        trials: the policies, the best first.
        letters: of each; two that share one are not told apart.
        contrasts: of every two policies, the better one first.
        adjusted: their p-values after Holm's correction.
        notes: what to know about the figures.
    """

    tool: ClassVar[str] = "compare"
    trials: Sequence[Trials]
    letters: Sequence[str]
    contrasts: Sequence[Contrast]
    adjusted: Sequence[float]
    notes: list[str]

    def content(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dictionaries; None for what was not or cannot be measured."""
        return {
            "verdict": self.verdict,
            "reasons": self.reasons,
            "thresholds": {"level": LEVEL},
            "policies": [
                _policy_json(each, letter) for each, letter in zip(self.trials, self.letters, strict=True)
            ],
            "contrasts": [
                _contrast_json(each, p_value)
                for each, p_value in zip(self.contrasts, self.adjusted, strict=True)
            ],
            "notes": self.notes,
        }


def _policy_json(trials: Trials, letter: str) -> dict[str, Any]:
    return {
        "name": trials.name,
        "letters": letter,
        "mean": trials.mean,
        "seeds_apart": trials.seeds_apart,
        "episodes_apart": trials.episodes_apart,
        "trainings": [{**asdict(rate), "interval": list(rate.exact_interval)} for rate in trials.rates],
    }


def _contrast_json(contrast: Contrast, adjusted: float) -> dict[str, Any]:
    found = {**asdict(contrast), "interval": list(contrast.interval), "p_holm": adjusted}
    return {**found, "e_value": contrast.pairs and contrast.pairs.e_value}
