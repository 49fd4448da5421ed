"""Which execution is analysed: a checkpoint's, with explicit options on top of it."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, get_args

from act_chunking_runtime.settings import ExecutionSettings, Mode, Weighting
from lerobot_act_chunking.diagnostics.core.training import read_training
from lerobot_act_chunking.errors import unknown_choice
from lerobot_act_chunking.policies.loading import read_config

# ACT's own numbers, for when there is no checkpoint.
_ACT = {"chunk_size": 100, "execution": "ensemble", "replan_interval": 1}
_SURVIVE_ANOTHER_MODE = ("chunk_size", "n_action_steps", "latency_steps", "smoothing_steps", "gripper_dims")
_ENSEMBLE_ONLY = ("temporal_ensemble_coeff", "ensemble_weighting")


@dataclass(frozen=True)
class Source:
    """An execution and where it was read from.

    Attributes:
        settings: the execution.
        checkpoint: folder or repo id, if it was read from one.
        policy_type: of that policy.
        fps: control steps per second that it was trained at, as far as the checkpoint or its dataset tells.
    """

    settings: ExecutionSettings
    checkpoint: str | None = None
    policy_type: str | None = None
    fps: float | None = None


def read_source(checkpoint: str | None, overrides: Mapping[str, Any]) -> Source:
    """The execution of a checkpoint, or ACT's without one, with other values for some settings.

    Naming a coefficient or a weighting asks for an ensemble, naming ``crossfade_steps`` for a cross-fade.
    Another mode than the checkpoint's keeps its chunk, ``n_action_steps``, latency and grippers only.

    Args:
        checkpoint: folder or repo id of any policy that predicts chunks; only its configuration is read.
        overrides: fields of `ExecutionSettings`; None leaves a field as it is.

    Raises:
        ConfigurationError: no such checkpoint, a policy without chunks, or settings that cannot work.
    """
    given = {name: value for name, value in overrides.items() if value is not None}
    _check_choices(given)
    if checkpoint is None:
        return Source(_settings(_ACT, given))
    config = read_config(checkpoint)
    settings = _settings(_execution_of(config), given)
    return Source(settings, checkpoint, config.type, read_training(checkpoint, config).fps)


def _check_choices(given: dict[str, Any]) -> None:
    """Before the mode is used to decide what else to keep."""
    for name, choices in (("execution", get_args(Mode)), ("ensemble_weighting", get_args(Weighting))):
        if name in given and given[name] not in choices:
            raise unknown_choice(name, given[name], choices)


def _execution_of(config: Any) -> dict[str, Any]:
    """The fields of `ExecutionSettings` that a policy's configuration implies."""
    from lerobot_act_chunking.policies.chunk_length import chunk_length
    from lerobot_act_chunking.policies.execution_fields import ExecutionFields

    if isinstance(config, ExecutionFields):
        execution = {field.name: getattr(config, field.name) for field in fields(ExecutionFields)}
        settings = config.execution_settings  # pyright: ignore[reportAttributeAccessIssue]
        return execution | {"chunk_size": settings.chunk_size, "n_action_steps": settings.n_action_steps}
    coeff = getattr(config, "temporal_ensemble_coeff", None)
    if coeff is not None:  # LeRobot's ACT, which then replans at every step; a negative sign means recency
        return {
            "chunk_size": config.chunk_size,
            "execution": "ensemble",
            "replan_interval": 1,
            "temporal_ensemble_coeff": abs(coeff),
            "ensemble_weighting": "recency" if coeff < 0 else "act",
        }
    return {"chunk_size": chunk_length(config), "n_action_steps": getattr(config, "n_action_steps", None)}


def _settings(base: dict[str, Any], given: dict[str, Any]) -> ExecutionSettings:
    mode = given.get("execution") or _implied_mode(base, given)
    if mode != base.get("execution", "open_loop"):
        base = {name: base[name] for name in _SURVIVE_ANOTHER_MODE if name in base}
    if "ensemble_weighting" in given:
        base = {**base, "temporal_ensemble_coeff": None}
    if given.get("chunk_size", base["chunk_size"]) < (base.get("n_action_steps") or 0):
        base = {**base, "n_action_steps": None}
    if mode == "open_loop" and "n_action_steps" in given:
        base = {**base, "replan_interval": None}
    merged = {**base, **given, "execution": mode}
    merged = {name: value for name, value in merged.items() if value is not None}
    merged["gripper_dims"] = tuple(merged.get("gripper_dims", ()))
    if "execution" not in given and _one_chunk_at_a_time(merged):
        merged = {name: value for name, value in merged.items() if name not in _ENSEMBLE_ONLY}
        merged["execution"] = "open_loop"
    return ExecutionSettings(**merged)


def _implied_mode(base: dict[str, Any], given: dict[str, Any]) -> str:
    mode = base.get("execution", "open_loop")
    if "crossfade_steps" in given:
        return "crossfade"
    if any(name in given for name in _ENSEMBLE_ONLY) and mode != "adaptive":
        return "ensemble"
    return mode


def _one_chunk_at_a_time(merged: dict[str, Any]) -> bool:
    """Each chunk runs to its end: an ensemble of one, whatever its weights."""
    used = merged.get("n_action_steps") or merged["chunk_size"]
    return merged["execution"] == "ensemble" and merged.get("replan_interval") == used
