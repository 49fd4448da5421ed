"""What tells checkpoints and questions apart, so that what was measured of one is not taken for another's."""

import hashlib
import json
from collections.abc import Collection, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from lerobot.envs.configs import EnvConfig

from lerobot_act_chunking.diagnostics.core.success_keys import IS_SUCCESS, success_key
from lerobot_act_chunking.json_files import read_json
from lerobot_act_chunking.policies.loading import CONFIG, PROCESSORS, WEIGHTS


def checkpoint_digest(checkpoint: str, without: Collection[str] = ()) -> str:
    """SHA-256 of a checkpoint: configuration, weights, processors, statistics, and the policy that it wraps.

    Args:
        checkpoint: a folder; of a repo id its name alone is known.
        without: fields of the configuration that do not count.
    """
    content = hashlib.sha256()
    folder = Path(checkpoint)
    if not folder.is_dir():
        content.update(checkpoint.encode())
        return content.hexdigest()
    config = {name: value for name, value in read_json(folder / CONFIG).items() if name not in without}
    content.update(json.dumps(config, sort_keys=True).encode())
    if config.get("inner_path"):
        content.update(checkpoint_digest(config["inner_path"]).encode())
    states = sorted(each for each in folder.glob("*processor*.safetensors"))
    for path in (folder / WEIGHTS, *(folder / name for name in PROCESSORS), *states):
        if path.is_file():
            with path.open("rb") as file:
                content.update(hashlib.file_digest(file, "sha256").digest())
    return content.hexdigest()


def dataset_digest(dataset: str | Path) -> str | None:
    """SHA-256 of a LeRobotDataset: names and sizes of its files, and all that is no video or image.

    Args:
        dataset: its folder.

    Returns:
        None if there is no dataset.
    """
    folder, content = Path(dataset), hashlib.sha256()
    if not (folder / "meta" / "info.json").is_file():
        return None
    for path in sorted(each for each in folder.rglob("*") if each.is_file()):
        name = path.relative_to(folder)
        content.update(f"{name.as_posix()} {path.stat().st_size}".encode())
        if name.parts[0] in ("meta", "data"):
            with path.open("rb") as file:
                content.update(hashlib.file_digest(file, "sha256").digest())
    return content.hexdigest()


def environment_identity(env_config: EnvConfig) -> dict[str, str]:
    """The type of an environment and every field of its configuration, as text, and what means success."""
    fields: Mapping[str, Any] = asdict(env_config)  # pyright: ignore[reportArgumentType]
    key = success_key(env_config)
    named = {} if key == IS_SUCCESS else {"success_key": key}
    return {"type": env_config.type, **{name: repr(value) for name, value in fields.items()}, **named}


def question_digest(question: Mapping[str, Any]) -> str:
    """Twelve digits that follow from all that is asked."""
    return hashlib.sha256(json.dumps(question, sort_keys=True).encode()).hexdigest()[:12]
