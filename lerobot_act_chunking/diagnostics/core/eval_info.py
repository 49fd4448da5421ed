"""What ``lerobot-eval`` wrote of an evaluation."""

from pathlib import Path

from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate
from lerobot_act_chunking.errors import DatasetError
from lerobot_act_chunking.json_files import read_json


def read_success_rate(eval_info: Path) -> SuccessRate:
    """Read the success rate from the ``eval_info.json`` that ``lerobot-eval`` writes.

    Raises:
        DatasetError: the file is absent or is not lerobot-eval's.
    """
    try:
        tasks = read_json(eval_info)["per_task"]
        successes = [bool(success) for task in tasks for success in task["metrics"]["successes"]]
    except FileNotFoundError:
        raise DatasetError(
            f"no evaluation at {eval_info}; run lerobot-eval with this output folder first"
        ) from None
    except (ValueError, KeyError, TypeError) as error:
        raise DatasetError(f"{eval_info} is not an eval_info.json of lerobot-eval: {error!r}") from error
    return SuccessRate(sum(successes), len(successes))
