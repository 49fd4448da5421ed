"""Which files a LeRobotDataset's folder lacks."""

from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from lerobot_act_chunking.json_files import read_json

INFO = "meta/info.json"
NAMED = 3  # missing files that a message names


def what_is_missing(folder: Path) -> str:
    """Why there is no dataset to read in ``folder``, as the end of a sentence that begins with it."""
    if not folder.exists():
        return "does not exist"
    if not (folder / INFO).is_file():
        return f"holds no LeRobot dataset (no {INFO}){_elsewhere(folder)}"
    missing = missing_files(folder)
    if not missing:
        return "holds a LeRobot dataset that LeRobot does not accept as it is"
    more = f" and {len(missing) - NAMED} more" if len(missing) > NAMED else ""
    return f"holds an incomplete LeRobot dataset: {', '.join(missing[:NAMED])}{more} missing"


def missing_files(folder: Path) -> list[str]:
    """Files that a dataset's own tables name and that are not there; empty if those cannot be read either.

    Args:
        folder: with ``meta/info.json``.
    """
    try:
        return [name for name in _expected(folder) if not (folder / name).exists()]
    except (OSError, ValueError, KeyError, TypeError, pa.ArrowException):
        return []


def _expected(folder: Path) -> list[str]:
    """Every file that there should be, in the order of reading, each once."""
    info = read_json(folder / INFO)
    names = {"meta/tasks.parquet": None}
    tables = sorted((folder / "meta" / "episodes").rglob("*.parquet"))
    if not tables:
        names["meta/episodes/chunk-000/file-000.parquet"] = None
    for table in tables:
        for episode in pq.read_table(table).to_pylist():
            names |= dict.fromkeys(_of_episode(info, episode))
    return list(names)


def _of_episode(info: dict[str, Any], episode: dict[str, Any]) -> list[str]:
    videos = [key for key, feature in info["features"].items() if feature["dtype"] == "video"]
    of_data = {name: episode[f"data/{name}"] for name in ("chunk_index", "file_index")}
    names = [info["data_path"].format(**of_data)]
    for key in videos:
        of_video = {name: episode[f"videos/{key}/{name}"] for name in ("chunk_index", "file_index")}
        names.append(info["video_path"].format(video_key=key, **of_video))
    return names


def _elsewhere(folder: Path) -> str:
    """Datasets one level below, one of which may be meant."""
    below = sorted(path.parent.parent for path in folder.glob(f"*/{INFO}"))
    return f", but {', '.join(map(str, below[:NAMED]))} does" if below else ""
