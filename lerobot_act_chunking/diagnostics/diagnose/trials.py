"""Which interventions are tried on a policy: each changes one thing, for one hypothesis."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.diagnostics.core.executable import (
    FIELDS,
    STEPS,
    Executable,
    changed,
    denoises,
    predicting,
)
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.chunked_config import ChunkedConfig

LATENCY = "latency_steps"
RECENT = 0.1
"""How fast older chunks lose their weight [1 / control step], where an average may remember for too long."""
MORE_STEPS = 20
"""Denoising steps that are surely enough, or four times the present ones."""
BLENDING = ("ensemble", "adaptive")

MEANINGS = {
    "wrong statistics": "observations or actions are normalised by statistics of other data",
    "wrong mode": "what is drawn while acting takes or mixes ways that do not succeed",
    "too few steps": "chunks are not denoised to the end",
    "averaged weights": "the moving average of the weights lags behind the weights",
    "over-smoothing": "averaging blurs what the newest chunk says",
    "latency": "chunks come too late for what they were computed from",
    "jitter": "single predictions tremble",
    "chunk boundary": "chunks do not go on where the one before them ends",
    "chunk too long": "a chunk is used for too long before the next observation counts",
    "chunk too short": "a chunk is given up too soon, so that the policy waits or wavers",
    "under-training": "training was too short",
}
"""What each hypothesis says. The first of two that explain the same is named."""


@dataclass(frozen=True)
class Trial:
    """The policy with one thing changed.

    Attributes:
        hypothesis: that speaks for it; of `MEANINGS`.
        change: what is changed, in words.
        repair: the options or the command that keep the change; empty for none.
        values: fields of the configuration that says how chunks are executed.
        acting: fields of the configuration of the policy that predicts.
        statistics: of the dataset in this folder, in place of the checkpoint's.
        checkpoint: weights of another one, of the same training.
        raw_weights: act with the weights themselves in place of their average.
        draw: other noise than the policy's own.
        size: how much changes; of trials that do the same good the smallest is named.
    """

    hypothesis: str
    change: str
    repair: str = ""
    values: tuple[tuple[str, Any], ...] = ()
    acting: tuple[tuple[str, Any], ...] = ()
    statistics: str | None = None
    checkpoint: str | None = None
    raw_weights: bool = False
    draw: int = 0
    size: int = 1

    @property
    def key(self) -> str:
        """By which its episodes are kept: everything that they depend on."""
        changes = [f"{name}={value}" for name, value in (*self.values, *self.acting) if value is not None]
        named = {
            "statistics": self.statistics,
            "checkpoint": self.checkpoint,
            "raw_weights": self.raw_weights,
            "draw": self.draw,
        }
        return " ".join([*changes, *(f"{name}={value}" for name, value in named.items() if value)])


AS_IT_IS = Trial("", "nothing")
REPETITION = Trial("repetition", "nothing but the policy's noise", draw=1)


def make_trials(
    executable: Executable, *, smoothing: int = 1, statistics: str | None = None, later: Path | None = None
) -> list[Trial]:
    """All interventions that this policy can take, a single one of each kind.

    Args:
        executable: the checkpoint.
        smoothing: ``smoothing_steps`` to try [control steps]; 1: none.
        statistics: a dataset's folder whose statistics differ from the checkpoint's.
        later: a checkpoint after this one, of the same training.
    """
    config = executable.config
    trials = []
    if statistics is not None:
        trials.append(
            Trial(
                "wrong statistics",
                f"statistics of {statistics}",
                "train anew on the data that the statistics are of, or put the statistics of the training "
                "data into policy_preprocessor and policy_postprocessor",
                statistics=statistics,
            )
        )
    if later is not None:
        trials.append(Trial("under-training", f"weights of {later}", f"use {later}", checkpoint=str(later)))
    if getattr(predicting(config), "use_ema", False):
        trials.append(
            Trial(
                "averaged weights",
                "the weights in place of their average",
                "--policy.use_ema=false, or train longer with a smaller --policy.ema_max_value",
                raw_weights=True,
            )
        )
    trials += _drawing(executable)
    trials += _executing(executable, smoothing)
    known: dict[str, Trial] = {}
    for each in trials:
        known.setdefault(each.key, each)
    return list(known.values())


def _drawing(executable: Executable) -> Iterator[Trial]:
    """Other draws, and other ways of making something of them."""
    if not isinstance(predicting(executable.config), ChunkedConfig):
        return
    config: Any = predicting(executable.config)
    changes: list[tuple[str, str, dict[str, Any]]] = []
    if config.type == "act_chunked" and config.is_stochastic:
        if config.use_vae and config.z_inference == "sample":
            changes.append(("wrong mode", "the likeliest latent", {"z_inference": "mode"}))
            if config.z_hold != "episode":
                held = {"z_hold": "episode", "z_hold_steps": 0}
                changes.append(("wrong mode", "one latent for an episode", held))
        if config.action_temperature > 0:
            changes.append(("wrong mode", "the likeliest actions", {"action_temperature": 0.0}))
    if config.type == "vqbet_chunked" and config.bet_softmax_temperature > 0:
        changes.append(("wrong mode", "the likeliest codes", {"bet_softmax_temperature": 0.0}))
        if config.code_hold != "episode":
            changes.append(("wrong mode", "one draw of codes for an episode", {"code_hold": "episode"}))
    if denoises(config):
        more = max(MORE_STEPS, 4 * config.num_inference_steps)
        changes.append(("too few steps", f"{more} denoising steps", {STEPS: more}))
    for hypothesis, words, values in changes:
        if _possible(config, values) is not None:
            yield Trial(hypothesis, words, _flags(executable, values), acting=tuple(values.items()))


def _executing(executable: Executable, smoothing: int) -> Iterator[Trial]:
    """Other executions of the same chunks."""
    config = executable.config
    present = config.execution_settings
    kept = {name: getattr(config, name) for name in FIELDS}
    for hypothesis, words, size, changes in _executions(present, smoothing):
        mode = changes.get("execution", present.execution)
        base: dict[str, Any] = kept if mode == present.execution else dict.fromkeys(FIELDS)
        values = {
            **base,
            "n_action_steps": present.n_action_steps,
            "replan_interval": None if mode == "open_loop" else present.replan_interval,
            "smoothing_steps": kept["smoothing_steps"],
            **changes,
        }
        if _possible(config, values) is not None:
            flags = _flags(executable, values)
            yield Trial(hypothesis, words, flags, values=tuple(values.items()), size=size)


def _executions(present: ExecutionSettings, smoothing: int) -> Iterator[tuple[str, str, int, dict[str, Any]]]:
    """Hypothesis, words, size of the change and fields of each."""
    mode, used, every = present.execution, present.n_action_steps, present.replan_interval
    if present.latency_steps:
        yield "latency", "no latency", 1, {LATENCY: 0}
    if mode in BLENDING:
        yield "over-smoothing", "the newest chunk alone", 1, {"execution": "receding"}
    if mode in ("ensemble", "adaptive") and present.weight_growth > -RECENT:
        recent = {"ensemble_weighting": "recency", "temporal_ensemble_coeff": RECENT}
        yield "over-smoothing", "new chunks weighing more", 1, recent
    if present.smoothing_steps > 1:
        yield "over-smoothing", "chunks as they are predicted", 1, {"smoothing_steps": None}
    elif smoothing > 1:
        yield "jitter", f"chunks smoothed over {smoothing} steps", 1, {"smoothing_steps": smoothing}
    yield from _lengths(mode, present.chunk_size, used, every)
    if mode == "receding":
        yield "chunk boundary", "blended chunks", 1, {"execution": "crossfade"}
    if mode == "open_loop":
        blended = {"execution": "crossfade", "n_action_steps": min(present.chunk_size, used + -(-used // 4))}
        every = min(used, 3 * blended["n_action_steps"] // 4)
        yield "chunk boundary", "blended chunks", 2, {**blended, "replan_interval": max(1, every)}


def _lengths(mode: str, chunk: int, used: int, every: int) -> Iterator[tuple[str, str, int, dict[str, Any]]]:
    if mode == "open_loop":
        short = max(1, used // 4)
        if short < used:
            yield "chunk too long", f"{short} steps of each chunk", 1, {"n_action_steps": short}
        if used < chunk:
            yield "chunk too short", "whole chunks", 1, {"n_action_steps": chunk}
        return
    if every > 1:
        sooner = max(1, every // 4)
        yield "chunk too long", f"a new chunk every {sooner} steps", 1, {"replan_interval": sooner}
    rare = {"crossfade_steps": None}
    for later, size in ((max(every + 1, chunk // 4), 1), (max(every + 1, 3 * chunk // 4), 1)):
        if later < used:
            yield (
                "chunk too short",
                f"a new chunk every {later} steps",
                size,
                {**rare, "replan_interval": later},
            )
    whole = {"execution": "open_loop", "n_action_steps": chunk}
    yield "chunk too short", "whole chunks, one after the other", 2, whole


def _possible(config: Any, values: Mapping[str, Any]) -> Any:
    """The configuration with these values; None where they cannot work."""
    try:
        return changed(config, dict(values))
    except ConfigurationError:
        return None


def _flags(executable: Executable, values: Mapping[str, Any]) -> str:
    """The options that make the values; a command where the checkpoint cannot hold them."""
    own = predicting(executable.config) if STEPS in values else executable.config
    new = {name: value for name, value in values.items() if getattr(own, name, None) != value}
    if executable.wrapped:
        words = [f"--{name.replace('_', '-')} {value}" for name, value in new.items() if value is not None]
        return " ".join(["act-chunking wrap", executable.checkpoint, "--out <folder>", *words])
    return " ".join(f"--policy.{name}={'null' if value is None else value}" for name, value in new.items())
