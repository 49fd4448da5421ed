"""The answer in words."""

from dataclasses import dataclass

from lerobot_act_chunking.diagnostics.core.report import Judgement
from lerobot_act_chunking.diagnostics.modes.causes import NONE, Cause
from lerobot_act_chunking.diagnostics.modes.frequencies import Frequencies
from lerobot_act_chunking.diagnostics.modes.settings import Thresholds

SURELY = 0.01
"""P-value below which the ways are not taken as often as they were demonstrated."""


@dataclass(frozen=True)
class ModeJudgement(Judgement):
    """The answer.

    Attributes:
        cause: why it fails.
    """

    cause: Cause


def judge(
    episodes: Frequencies | None, chunks: Frequencies | None, cause: Cause, thresholds: Thresholds
) -> ModeJudgement:
    """All ways taken, and hardly any other? Chunks that are worse than the episodes are a warning.

    Args:
        episodes: the ways that they went; None if no ways are known.
        chunks: the ways of chunks at their starts, if they are known.
        cause: why episodes, or chunks, do not go all ways.
        thresholds: when to worry.
    """
    if episodes is None:
        known = (
            "no ways are known: neither does the dataset record modes or fall into clusters, nor does the "
            "environment say info['mode'] and --shares how often each was demonstrated"
        )
        return ModeJudgement("inconclusive", [known], cause)
    told = _taken(episodes, thresholds)
    least = min(share for share in episodes.proportions if share > 0)
    if least * episodes.n < thresholds.expected:
        needed = -int(-thresholds.expected // least)
        few = f"{episodes.n} episodes are too few for a way that {least:.0%} of the demonstrations go"
        return ModeJudgement("inconclusive", [f"{few}: run --episodes {needed}", told], cause)
    why = [f"{cause.name}: {cause.because}", f"repair: {cause.fix}"] if cause.name != NONE else []
    if not episodes.good(thresholds):
        return ModeJudgement("fail", [told, *why], cause)
    worse = _worse(chunks, thresholds)
    return ModeJudgement("warn" if worse else "pass", [told, *_unlike(episodes), *worse, *why], cause)


def _taken(episodes: Frequencies, thresholds: Thresholds) -> str:
    shares = "/".join(f"{100 * each:.0f}" for each in episodes.shares)
    shown = "/".join(f"{100 * each:.0f}" for each in episodes.proportions)
    demonstrated = [mode for mode, share in enumerate(episodes.proportions) if share > 0]
    covered = len(demonstrated) - len(episodes.missing(thresholds))
    return (
        f"{covered} of {len(demonstrated)} ways are taken ({shares} % of the episodes, demonstrated {shown} "
        f"%), and {100 * episodes.invalid_share:.1f} % of the episodes go none of them"
    )


def _worse(chunks: Frequencies | None, thresholds: Thresholds) -> list[str]:
    if chunks is None or chunks.good(thresholds):
        return []
    missing = "".join(f", and hardly any goes mode {mode}" for mode in chunks.missing(thresholds))
    invalid = f"{100 * chunks.invalid_share:.0f} % of the chunks at the starts go none of them"
    return [f"the episodes put right what the chunks are not: {invalid}{missing}"]


def _unlike(episodes: Frequencies) -> list[str]:
    p_value = episodes.p_value
    if p_value is None or p_value >= SURELY:
        return []
    return [f"but not as often as they were demonstrated (p = {p_value:.2g})"]
