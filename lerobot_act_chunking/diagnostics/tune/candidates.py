"""Which ways of executing a policy are tried."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.diagnostics.core.executable import STEPS
from lerobot_act_chunking.errors import ConfigurationError

INTERVALS = (0.05, 0.1, 0.25, 0.5)
"""Replanning intervals, as shares of a chunk; a quarter is the default of all modes."""
FEWER_STEPS = (2, 10)
"""Denoising steps to try beside the present number."""


@dataclass(frozen=True)
class Candidate:
    """One way of executing a policy.

    Attributes:
        values: of the configuration's fields, where None asks for the default of the mode.
        settings: what they mean, with all defaults filled in.
        denoising_steps: network calls for a chunk, of policies that denoise.
    """

    values: tuple[tuple[str, Any], ...]
    settings: ExecutionSettings
    denoising_steps: int | None = None

    def __str__(self) -> str:
        settings = self.settings
        words = [settings.execution]
        if settings.execution in ("ensemble", "adaptive"):
            words.append(f"{settings.ensemble_weighting}")
        if settings.execution != "open_loop":
            words.append(f"R={settings.replan_interval}")
        words.append(f"n={settings.n_action_steps}")
        if settings.smoothing_steps > 1:
            words.append(f"smooth={settings.smoothing_steps}")
        if self.denoising_steps is not None:
            words.append(f"steps={self.denoising_steps}")
        return " ".join(words)

    @property
    def key(self) -> str:
        """All its values in one line, by which its results are kept."""
        return " ".join(f"{name}={value}" for name, value in self.values if value is not None)

    def calls_per_second(self, fps: float) -> float:
        """Network calls per second of motion, denoising steps and sampled chunks counted."""
        per_chunk = (self.denoising_steps or 1) * (self.settings.n_samples or 1)
        return fps / self.settings.replan_interval * per_chunk


Make = Callable[[dict[str, Any]], Candidate]
"""Makes a candidate of changed fields; refuses, by ConfigurationError, what the policy cannot do."""


def make_candidates(present: Candidate, make: Make, smoothing: int = 1) -> list[Candidate]:
    """The present settings, then all others that the policy can be executed with, none of them twice.

    Args:
        present: how the policy is executed now.
        make: of the policy.
        smoothing: ``smoothing_steps`` to try [control steps]; 1: none.
    """
    found = {(present.settings, present.denoising_steps): present}
    for changes in _grid(present.settings.chunk_size, present.denoising_steps, smoothing):
        try:
            candidate = make(changes)
        except ConfigurationError:
            continue
        found.setdefault((candidate.settings, candidate.denoising_steps), candidate)
    return list(found.values())


def _grid(chunk: int, steps: int | None, smoothing: int) -> Iterator[dict[str, Any]]:
    """What is tried, coarse where neighbours do the same."""
    intervals = sorted({max(1, round(share * chunk)) for share in INTERVALS})
    half = max(1, chunk // 2)
    yield {"execution": "open_loop", "n_action_steps": chunk}
    for interval in intervals:
        often = {"n_action_steps": chunk, "replan_interval": interval}
        yield {**often, "execution": "receding"}
        yield {**often, "execution": "crossfade"}
        yield {**often, "execution": "ensemble", "ensemble_weighting": "act"}
        if interval < half:
            yield {**often, "execution": "ensemble", "ensemble_weighting": "recency"}
            yield {**often, "execution": "ensemble", "ensemble_weighting": "act", "n_action_steps": half}
    if smoothing > 1:
        smooth = {"n_action_steps": chunk, "smoothing_steps": smoothing}
        yield {**smooth, "execution": "open_loop"}
        for interval in intervals[1:3]:
            yield {**smooth, "execution": "crossfade", "replan_interval": interval}
    if steps is None:
        return
    for other in FEWER_STEPS:
        for interval in intervals[1:]:
            yield {
                "execution": "crossfade",
                "n_action_steps": chunk,
                "replan_interval": interval,
                STEPS: other,
            }
