"""Who demonstrates, and whom to hold out for validation."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata

from lerobot_act_chunking.diagnostics.data.recording import EPISODE, read_columns
from lerobot_act_chunking.errors import FeatureError
from lerobot_act_chunking.json_files import read_json

SUMMARY = "meta/recording.json"
"""What ``act-chunking record`` writes."""
COLUMNS = ("operator", "operator_id", "operator_index", "demonstrator", "person")
HELD_OUT = 0.2
"""Share of the episodes that validation takes, as nearly as whole operators allow."""


@dataclass(frozen=True)
class Split:
    """Training and validation by different people.

    Attributes:
        counts: episodes by operator.
        held_out: the operator to validate on.
        train: episodes of all others.
        validation: episodes of this one.
    """

    counts: dict[str, int]
    held_out: str
    train: list[int]
    validation: list[int]


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


def split_by_operator(operators: dict[int, str]) -> Split | None:
    """Hold out the operator whose share of the episodes is nearest to a fifth; None of fewer than two."""
    counts = Counter(operators.values())
    if len(counts) < 2:
        return None
    wanted = HELD_OUT * len(operators)
    held_out = min(sorted(counts), key=lambda name: abs(counts[name] - wanted))
    return Split(
        counts=dict(sorted(counts.items())),
        held_out=held_out,
        train=[each for each, name in operators.items() if name != held_out],
        validation=[each for each, name in operators.items() if name == held_out],
    )


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
