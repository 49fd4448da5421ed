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
        DatasetError: the file is absent, is not lerobot-eval's, holds no episode, or one of which it is not
            known whether it succeeded.
    """
    try:
        outcomes = {
            (str(task.get("task_group", "")), int(task.get("task_id", place)), number): success
            for place, task in enumerate(read_json(eval_info)["per_task"])
            for number, success in enumerate(task["metrics"]["successes"])
        }
    except (FileNotFoundError, NotADirectoryError):
        raise DatasetError(
            f"no evaluation at {eval_info}; run lerobot-eval with this output folder first"
        ) from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise DatasetError(f"{eval_info} is not an {EVAL_INFO} of lerobot-eval: {error!r}") from error
    if not outcomes:
        raise DatasetError(f"{eval_info} holds no episode: run lerobot-eval again")
    if None in outcomes.values():
        raise DatasetError(
            f"{eval_info} does not know which episodes succeeded, since their environment never said it: run "
            "act-chunking eval again with --success-key, which names what means success"
        )
    return {episode: bool(success) for episode, success in outcomes.items()}


def read_success_rate(eval_info: Path) -> SuccessRate:
    """The success rate over all episodes of all tasks.

    Raises:
        DatasetError: as `read_outcomes`.
    """
    outcomes = read_outcomes(eval_info)
    return SuccessRate(sum(outcomes.values()), len(outcomes))
