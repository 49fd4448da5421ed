"""The chosen settings, into the checkpoint's configuration."""

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lerobot_act_chunking.diagnostics.tune.candidates import Candidate
from lerobot_act_chunking.diagnostics.tune.subject import Subject
from lerobot_act_chunking.durable_files import write_atomically
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.json_files import read_json
from lerobot_act_chunking.policies.loading import CONFIG


@dataclass(frozen=True)
class Change:
    """One field of a configuration, as it was and as it is to be."""

    name: str
    old: Any
    new: Any

    def __str__(self) -> str:
        return f"{self.name}: {json.dumps(self.old)} -> {json.dumps(self.new)}"

    @property
    def flag(self) -> str:
        """The option that makes it for one run."""
        return f"--policy.{self.name}={'null' if self.new is None else self.new}"


def changes(subject: Subject, chosen: Candidate) -> list[Change]:
    """What has to change in the configuration for the chosen settings, and nothing else."""
    if chosen == subject.present:
        return []
    values = {**dict(chosen.values)}
    if getattr(subject.config, "replan_s", None) is not None:
        values["replan_s"] = None  # it would contradict the interval
    old = {name: getattr(subject.config, name) for name in values}
    return [Change(name, old[name], value) for name, value in values.items() if old[name] != value]


def wrap_command(subject: Subject, chosen: Candidate) -> str:
    """The command that makes a checkpoint with these settings of one that cannot hold them itself."""
    options = {"temporal_ensemble_coeff": "coeff", "ensemble_weighting": "weighting"}
    given = {options.get(name, name): value for name, value in chosen.values if value is not None}
    words = [f"--{name.replace('_', '-')} {value}" for name, value in given.items()]
    return " ".join(["act-chunking wrap", subject.checkpoint, "--out", "<folder>", *words])


def check_writable(subject: Subject) -> None:
    """Refuse what `write` could not do, before anything is measured.

    Raises:
        ConfigurationError: no folder, one that may not be written to, or a type without such settings.
    """
    folder = Path(subject.checkpoint)
    if subject.wrapped:
        raise ConfigurationError(
            f"--write: the configuration at {folder} has no settings of chunk execution: run without "
            "--write, which ends with the act-chunking wrap command for the choice"
        )
    if not folder.is_dir():
        raise ConfigurationError(
            f"--write changes a checkpoint's folder, and {folder} is none: download it first"
        )
    if not all(os.access(path, os.W_OK) for path in (folder, folder / CONFIG)):
        raise ConfigurationError(
            f"--write: {folder} may not be written to: copy the checkpoint, or run without"
        )


def write(checkpoint: str, made: list[Change]) -> None:
    """Put the new values into the checkpoint's configuration, whole or not at all; all else stays.

    Raises:
        ConfigurationError: the disk does not take it.
    """
    path = Path(checkpoint) / CONFIG
    content = read_json(path)
    content |= {change.name: change.new for change in made}
    try:
        write_atomically(path, json.dumps(content, indent=4).encode())
    except OSError as error:
        raise ConfigurationError(f"{path} could not be written, and is as it was: {error}") from error
