"""A checkpoint as something that can be executed in many ways."""

from dataclasses import dataclass, fields, replace
from typing import Any

from lerobot_act_chunking.diagnostics.core.digests import checkpoint_digest
from lerobot_act_chunking.diagnostics.core.training import read_training
from lerobot_act_chunking.diagnostics.tune.candidates import FIELDS, STEPS, Candidate, make_candidates
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.chunked_config import ChunkedConfig
from lerobot_act_chunking.policies.dataset_defaults import PRESETS_FPS, spaced_stride
from lerobot_act_chunking.policies.loading import LoadedPolicy, load_policy, read_config
from lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble import (
    TemporalEnsembleConfig,
)
from lerobot_act_chunking.policies.temporal_ensemble.wrapping import load_wrapped


@dataclass(frozen=True)
class Subject:
    """What is tuned.

    Attributes:
        checkpoint: folder or repo id.
        config: the policy's, or a wrapper's around it where its own cannot say how chunks are executed.
        wrapped: whether it is such a wrapper's.
        candidates: the present settings first.
    """

    checkpoint: str
    config: Any
    wrapped: bool
    candidates: list[Candidate]

    @property
    def present(self) -> Candidate:
        """How the policy is executed now."""
        return self.candidates[0]

    def load(self) -> LoadedPolicy:
        """The policy, ready to be executed as any candidate."""
        return load_wrapped(self.checkpoint) if self.wrapped else load_policy(self.checkpoint)


def read_subject(checkpoint: str) -> Subject:
    """What can be tried with a checkpoint; no weights are read.

    Raises:
        ConfigurationError: no such checkpoint, or one that predicts no chunks.
    """
    config = read_config(checkpoint)
    wrapped = not isinstance(config, ChunkedConfig | TemporalEnsembleConfig)
    if wrapped:
        config = TemporalEnsembleConfig(
            inner_path=checkpoint, push_to_hub=False, **_own_execution(config, checkpoint)
        )
    names = [*FIELDS, *([STEPS] if _denoises(config) else [])]
    present = _candidate(config, {name: getattr(config, name) for name in names})

    def make(changes: dict[str, Any]) -> Candidate:
        kept = {STEPS: present.denoising_steps} if STEPS in names else {}
        values = {**dict.fromkeys(names), **kept, **changes}
        return _candidate(_changed(config, values), values)

    candidates = make_candidates(
        present, make, smoothing_to_try(config, read_training(checkpoint, config).fps)
    )
    return Subject(checkpoint, config, wrapped, candidates)


def smoothing_to_try(config: Any, fps: float | None) -> int:
    """The odd number of control steps within a tenth of a second; 1 if predictions lie apart already.

    Args:
        config: the policy's, or a wrapper's.
        fps: control steps per second; None, not known, is taken as `PRESETS_FPS`.
    """
    predicting = getattr(config, "inner_config", config)
    if getattr(predicting, "chunk_stride", 1) > 1:
        return 1
    within = spaced_stride(fps or PRESETS_FPS)
    return within - 1 + within % 2


def execute(policy: LoadedPolicy, candidate: Candidate) -> None:
    """Let a loaded policy act as a candidate from its next ``reset`` on."""
    for name, value in candidate.values:
        setattr(policy.policy.config, name, value)


def digest(subject: Subject) -> str:
    """What tells this checkpoint from all others, however it is executed."""
    return checkpoint_digest(subject.checkpoint, without=(*FIELDS, STEPS, "replan_s"))


def _candidate(config: Any, values: dict[str, Any]) -> Candidate:
    return Candidate(tuple(values.items()), config.execution_settings, values.get(STEPS))


def _denoises(config: Any) -> bool:
    """Whether acting reads the number of denoising steps from the configuration; LeRobot's do not."""
    own = isinstance(config, ChunkedConfig) and STEPS in {each.name for each in fields(config)}
    return own and getattr(config, STEPS) is not None


def _changed(config: Any, values: dict[str, Any]) -> Any:
    """The configuration with these values, checked as on construction.

    Raises:
        ConfigurationError: they cannot work.
    """
    if isinstance(config, ChunkedConfig):
        return config.variant(**values, replan_s=None)
    return replace(config, **values)


def _own_execution(config: Any, checkpoint: str) -> dict[str, Any]:
    """How LeRobot's policies execute their chunks themselves, in the wrapper's words."""
    coeff = getattr(config, "temporal_ensemble_coeff", None)
    if coeff is not None:
        weighting = "act" if coeff >= 0 else "recency"
        return {
            "execution": "ensemble",
            "replan_interval": 1,
            "temporal_ensemble_coeff": abs(coeff),
            "ensemble_weighting": weighting,
        }
    used = getattr(config, "n_action_steps", None)
    if used is not None and used < 1:
        raise ConfigurationError(f"{checkpoint}: n_action_steps={used} executes nothing: set 1 or more")
    return {"execution": "open_loop", "n_action_steps": used}
