"""A checkpoint with all ways of executing it that are tried."""

from dataclasses import dataclass
from typing import Any

from lerobot_act_chunking.diagnostics.core.executable import (
    FIELDS,
    STEPS,
    Executable,
    changed,
    denoises,
    read_executable,
    smoothing_to_try,
)
from lerobot_act_chunking.diagnostics.core.training import read_training
from lerobot_act_chunking.diagnostics.tune.candidates import Candidate, make_candidates


@dataclass(frozen=True)
class Subject(Executable):
    """What is tuned.

    Attributes:
        candidates: the present settings first.
    """

    candidates: list[Candidate]

    @property
    def present(self) -> Candidate:
        """How the policy is executed now."""
        return self.candidates[0]


def read_subject(checkpoint: str) -> Subject:
    """What can be tried with a checkpoint; no weights are read.

    Raises:
        ConfigurationError: no such checkpoint, or one that predicts no chunks.
    """
    executable = read_executable(checkpoint)
    config = executable.config
    names = [*FIELDS, *([STEPS] if denoises(config) else [])]
    present = _candidate(config, {name: getattr(config, name) for name in names})

    def make(changes: dict[str, Any]) -> Candidate:
        kept = {STEPS: present.denoising_steps} if STEPS in names else {}
        values = {**dict.fromkeys(names), **kept, **changes}
        return _candidate(changed(config, values), values)

    candidates = make_candidates(
        present, make, smoothing_to_try(config, read_training(checkpoint, config).fps)
    )
    return Subject(checkpoint, config, executable.wrapped, candidates)


def _candidate(config: Any, values: dict[str, Any]) -> Candidate:
    return Candidate(tuple(values.items()), config.execution_settings, values.get(STEPS))
