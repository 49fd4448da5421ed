"""What ``lerobot-eval`` wrote of an evaluation."""

import json
from pathlib import Path

from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate
from lerobot_act_chunking.errors import DatasetError


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
