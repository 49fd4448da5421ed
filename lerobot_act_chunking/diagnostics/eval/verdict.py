"""The answer in words."""

from collections.abc import Sequence

from lerobot_act_chunking.diagnostics.core.report import Judgement
from lerobot_act_chunking.diagnostics.eval.deciding import Decision
from lerobot_act_chunking.diagnostics.eval.report import RunResult

MOST_LABELS = 3


def judge(
    results: Sequence[RunResult], decision: Decision | None, never_said: str | None = None
) -> Judgement:
    """How often each succeeds and what goes wrong; undecided where nothing is known of success.

    Args:
        results: of every checkpoint and draw.
        decision: of a comparison that was to end as soon as it is decided.
        never_said: that the environment says nothing of success, if that is so.
    """
    if never_said is not None:
        return Judgement("inconclusive", [never_said])
    if decision is None:
        return Judgement("pass", [_told(each) for each in results])
    low = min(decision.e_values.values())
    at = f"after {decision.episodes} of at most {decision.most} episodes each"
    if decision.decided:
        return Judgement("pass", [f"{decision.best} succeeds most often: decided {at} (e-value {low:.3g})"])
    return Judgement(
        "inconclusive",
        [f"not decided {at}: the e-value is {low:.2g}, {decision.needed:g} decide; run more --episodes"],
    )


def _told(result: RunResult) -> str:
    rate = result.rate
    low, high = (100 * end for end in rate.exact_interval)
    text = (
        f"{result.run.title} succeeds in {rate.successes} of {rate.episodes} episodes "
        f"({100 * rate.rate:.1f} %, 95 % interval {low:.1f} to {high:.1f})"
    )
    failures = list(result.failures.items())
    if not failures:
        return text
    told = [f"{label} {count}" for label, count in failures[:MOST_LABELS]]
    more = len(failures) - MOST_LABELS
    return f"{text}; failures: {', '.join(told)}{f' and {more} other kinds' if more > 0 else ''}"
