"""Who demonstrates."""

from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata

from lerobot_act_chunking.diagnostics.core.recording import EPISODE, read_columns
from lerobot_act_chunking.errors import FeatureError
from lerobot_act_chunking.json_files import read_json

SUMMARY = "meta/recording.json"
"""What ``act-chunking record`` writes."""
COLUMNS = ("operator", "operator_id", "operator_index", "demonstrator", "person")


def read_operators(meta: LeRobotDatasetMetadata, column: str | None = None) -> dict[int, str]:
    """Who demonstrates each episode; empty where nobody is named.

    Args:
        meta: of the dataset.
        column: of the frames or of the episodes; None for what recordings call it.

    Raises:
        FeatureError: there is no such column.
    """
    of_episodes = sorted((Path(meta.root) / "meta" / "episodes").rglob("*.parquet"))
    there = {*meta.features, *(name for file in of_episodes[:1] for name in pq.read_schema(file).names)}
    if column is not None and column not in there:
        raise FeatureError(
            f"the dataset at {meta.root} has no column {column!r} (--operator-column): its frames have "
            f"{', '.join(meta.features)}"
        )
    named = next((each for each in ((column,) if column else COLUMNS) if each in there), None)
    if named is None:
        return _of_summary(Path(meta.root) / SUMMARY)
    if named in meta.features:
        return _first_of_each(read_columns(meta, [EPISODE, named]), named)
    tables = [pq.read_table(file, columns=[EPISODE, named]) for file in of_episodes]
    return _first_of_each(pa.concat_tables(tables), named)


def _first_of_each(table: pa.Table, column: str) -> dict[int, str]:
    found: dict[int, str] = {}
    for row in table.to_pylist():
        found.setdefault(_single(row[EPISODE]), str(_single(row[column])))
    return found


def _single(value: Any) -> Any:
    return value[0] if isinstance(value, list) else value


def _of_summary(path: Path) -> dict[int, str]:
    """Operators among the details of the episodes; none where the file is absent or another's."""
    try:
        episodes = read_json(path)["episodes"]
        return {
            int(each["episode_index"]): str(each["details"]["operator"])
            for each in episodes
            if "operator" in each["details"]
        }
    except (OSError, ValueError, KeyError, TypeError):
        return {}
