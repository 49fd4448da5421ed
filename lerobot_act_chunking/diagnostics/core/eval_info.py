"""What ``lerobot-eval`` wrote of an evaluation."""

from pathlib import Path

from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate
from lerobot_act_chunking.errors import DatasetError
from lerobot_act_chunking.json_files import read_json

EVAL_INFO = "eval_info.json"
Episode = tuple[str, int, int]
"""Group of the task, number of the task in it, number of the episode."""


def read_outcomes(eval_info: Path) -> dict[Episode, bool]:
    """Whether each episode succeeded, from the ``eval_info.json`` that ``lerobot-eval`` writes.

    Raises:
        DatasetError: the file is absent, is not lerobot-eval's, or holds no episode.
    """
    try:
        outcomes = {
            (str(task.get("task_group", "")), int(task.get("task_id", place)), number): bool(success)
            for place, task in enumerate(read_json(eval_info)["per_task"])
            for number, success in enumerate(task["metrics"]["successes"])
        }
    except FileNotFoundError:
        raise DatasetError(
            f"no evaluation at {eval_info}; run lerobot-eval with this output folder first"
        ) from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise DatasetError(f"{eval_info} is not an {EVAL_INFO} of lerobot-eval: {error!r}") from error
    if not outcomes:
        raise DatasetError(f"{eval_info} holds no episode: run lerobot-eval again")
    return outcomes


def read_success_rate(eval_info: Path) -> SuccessRate:
    """The success rate over all episodes of all tasks.

    Raises:
        DatasetError: as `read_outcomes`.
    """
    outcomes = read_outcomes(eval_info)
    return SuccessRate(sum(outcomes.values()), len(outcomes))
