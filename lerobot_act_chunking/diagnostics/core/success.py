"""Success rates with the interval that a finite number of episodes allows."""

import json
from dataclasses import dataclass
from pathlib import Path

from lerobot_act_chunking.errors import DatasetError


@dataclass(frozen=True)
class SuccessRate:
    """Successes out of independent episodes, with a 95 % Wilson score interval (Wilson 1927).

    Raises:
        ValueError: more successes than episodes, or no episode at all.
    """

    successes: int
    episodes: int

    def __post_init__(self) -> None:
        if not 0 <= self.successes <= self.episodes or self.episodes == 0:
            raise ValueError(f"{self.successes} successes in {self.episodes} episodes is no success rate")

    @property
    def rate(self) -> float:
        """The share of successful episodes, in [0, 1]."""
        return self.successes / self.episodes

    @property
    def interval(self) -> tuple[float, float]:
        """Lower and upper end of the 95 % Wilson interval, in [0, 1]."""
        from scipy.stats import binomtest  # half a second of import that --help should not pay

        low, high = binomtest(self.successes, self.episodes).proportion_ci(method="wilson")
        return float(low), float(high)

    def __str__(self) -> str:
        low, high = self.interval
        return (
            f"{100 * self.rate:.1f} % ({self.successes}/{self.episodes} episodes, "
            f"95 % Wilson interval {100 * low:.1f}-{100 * high:.1f} %)"
        )


def read_success_rate(eval_info: Path) -> SuccessRate:
    """Read the success rate from the ``eval_info.json`` that ``lerobot-eval`` writes.

    Raises:
        DatasetError: the file is absent or is not lerobot-eval's.
    """
    try:
        tasks = json.loads(eval_info.read_text())["per_task"]
        successes = [bool(success) for task in tasks for success in task["metrics"]["successes"]]
    except FileNotFoundError:
        raise DatasetError(
            f"no evaluation at {eval_info}; run lerobot-eval with this output folder first"
        ) from None
    except (json.JSONDecodeError, KeyError, TypeError) as error:
        raise DatasetError(f"{eval_info} is not an eval_info.json of lerobot-eval: {error!r}") from error
    return SuccessRate(sum(successes), len(successes))
