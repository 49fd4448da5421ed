"""What can be asked of chunk execution, and which combinations make sense."""

import math
from dataclasses import dataclass
from typing import Literal, get_args

from act_chunking_runtime.errors import ConfigurationError, unknown_choice
from act_chunking_runtime.number_checks import check_at_least, check_positive

Mode = Literal["open_loop", "receding", "ensemble", "crossfade", "adaptive", "coherence"]
Weighting = Literal["act", "recency", "uniform"]
Kernel = Literal["cosine", "gaussian", "gate"]

DEFAULT_COEFF = 0.01  # ACT's
DEFAULT_SCALE = {"cosine": 5.0, "gaussian": 1.5, "gate": 3.0}
DEFAULT_SAMPLES = 8

# Settings that mean something in some modes only.
_USED_BY: dict[str, tuple[str, ...]] = {
    "temporal_ensemble_coeff": ("ensemble", "adaptive"),
    "ensemble_weighting": ("ensemble", "adaptive"),
    "crossfade_steps": ("crossfade",),
    "adaptive_kernel": ("adaptive",),
    "adaptive_scale": ("adaptive",),
    "n_samples": ("coherence",),
}

# Modes that work on the steps that two chunks cover and are both in time for.
_BLENDING = ("ensemble", "crossfade", "adaptive")


@dataclass(frozen=True)
class ExecutionSettings:
    """How chunks become one action per control step. ``None`` asks for the mode's default.

    A chunk is predicted every ``replan_interval`` steps (R) and its first ``n_action_steps`` actions may be
    used. What happens to those that a newer chunk covers as well is the mode:

    ===========  =====================================================================================
    open_loop    nothing overlaps: R = n_action_steps
    receding     the newest chunk replaces the older ones
    ensemble     the weighted mean of all chunks (ACT, Zhao et al. 2023, alg. 2)
    crossfade    the newest chunk, blended in linearly over ``crossfade_steps``
    adaptive     the weighted mean of the chunks that agree with the newest, by ``adaptive_kernel``
    coherence    the one of ``n_samples`` chunks that continues the current plan best (BID's backward
                 coherence, Liu et al. 2024); for policies that sample
    ===========  =====================================================================================

    Attributes:
        chunk_size: K, what a predicted chunk covers [control steps].
        execution: how chunks become actions; the modes are above.
        n_action_steps: how many of a chunk's first actions may be used; all by default.
        replan_interval: R [control steps]; a quarter of ``n_action_steps`` by default.
        latency_steps: d, a chunk computed from the observation at s is used from s + d on; until then the
            older ones continue. The first chunk of a rollout is used at once.
        background: compute each chunk beside the actions that wait, in a thread, for a robot in real time:
            it is used from the step on at which it is there, as with ``latency_steps``, by which the first
            chunks are expected. Only the first of a rollout is waited for. In a simulation leave it off: what
            comes of it depends on the machine.
        temporal_ensemble_coeff: m >= 0 [1 / control step], how fast weights change with age.
        ensemble_weighting: weight of a prediction made j steps ago: ``act`` exp(m j), the oldest weighs most,
            as in ACT and LeRobot; ``recency`` exp(-m j), the newest weighs most; ``uniform`` 1.
        crossfade_steps: length of the blend [control steps]; by default half of ``n_action_steps``, or what
            fits.
        adaptive_kernel: ``cosine`` (CogACT, Li et al. 2024, on changes instead of absolute targets),
            ``gaussian``, or ``gate``, which drops chunks far from the newest, and all after a disturbance.
        adaptive_scale: sharpness of the cosine kernel, width of the other two in median disagreements.
        n_samples: chunks to choose from.
        smoothing_steps: each chunk is first replaced by its centred moving mean over so many control steps,
            an odd number; 1, the default, leaves it as predicted. Try about a tenth of a second where a
            policy predicts every control step and its commands jitter.
        gripper_dims: action dimensions that are never averaged, blended or smoothed: the newest chunk
            decides.

    Raises:
        ConfigurationError: naming the value that cannot work, the reason and the way out.
    """

    chunk_size: int
    execution: Mode = "open_loop"
    n_action_steps: int = None  # pyright: ignore[reportAssignmentType]  (filled in on construction)
    replan_interval: int = None  # pyright: ignore[reportAssignmentType]
    latency_steps: int = 0
    temporal_ensemble_coeff: float | None = None
    ensemble_weighting: Weighting | None = None
    crossfade_steps: int | None = None
    adaptive_kernel: Kernel | None = None
    adaptive_scale: float | None = None
    n_samples: int | None = None
    smoothing_steps: int = None  # pyright: ignore[reportAssignmentType]
    gripper_dims: tuple[int, ...] = ()
    background: bool = False

    def __post_init__(self) -> None:
        self._check_choices()
        self._check_used()
        for name, value in self._defaults().items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, value)
        self._check_timing()
        self._check_ranges()

    def _defaults(self) -> dict[str, object]:
        used = self.n_action_steps or self.chunk_size
        longest = used - self.latency_steps - (self.execution in _BLENDING)
        interval = used if self.execution == "open_loop" else max(1, min(used // 4, longest))
        values: dict[str, object] = {
            "n_action_steps": used,
            "replan_interval": interval,
            "smoothing_steps": 1,
        }
        if self.execution in ("ensemble", "adaptive"):
            weighting = self.ensemble_weighting or "act"
            values["ensemble_weighting"] = weighting
            values["temporal_ensemble_coeff"] = 0.0 if weighting == "uniform" else DEFAULT_COEFF
        if self.execution == "crossfade":
            overlap = used - (self.replan_interval or interval) - self.latency_steps
            values["crossfade_steps"] = min(max(1, used // 2), overlap)
        if self.execution == "adaptive":
            values["adaptive_kernel"] = self.adaptive_kernel or "gate"
            values["adaptive_scale"] = DEFAULT_SCALE[self.adaptive_kernel or "gate"]
        if self.execution == "coherence":
            values["n_samples"] = DEFAULT_SAMPLES
        return values

    def _check_choices(self) -> None:
        for name, choices in (
            ("execution", get_args(Mode)),
            ("ensemble_weighting", (None, *get_args(Weighting))),
            ("adaptive_kernel", (None, *get_args(Kernel))),
        ):
            if getattr(self, name) not in choices:
                raise unknown_choice(name, getattr(self, name), [c for c in choices if c is not None])

    def _check_used(self) -> None:
        for name, modes in _USED_BY.items():
            value = getattr(self, name)
            if value is not None and self.execution not in modes:
                raise ConfigurationError(
                    f"{name}={value} has no effect with execution={self.execution}: "
                    f"set {' or '.join(f'execution={mode}' for mode in modes)}, or {name}=null"
                )
        coeff = self.temporal_ensemble_coeff
        if coeff is not None and not (math.isfinite(coeff) and coeff >= 0):
            raise ConfigurationError(
                f"temporal_ensemble_coeff={coeff} must be at least 0; to favour new predictions, for which "
                "LeRobot takes a negative one: set ensemble_weighting=recency and "
                f"temporal_ensemble_coeff={-coeff if math.isfinite(coeff) else DEFAULT_COEFF}"
            )
        if self.ensemble_weighting == "uniform" and coeff:
            raise ConfigurationError(
                f"temporal_ensemble_coeff={coeff} has no effect with ensemble_weighting=uniform: "
                "set temporal_ensemble_coeff=0, or ensemble_weighting=act or ensemble_weighting=recency"
            )

    def _check_timing(self) -> None:
        used, interval, latency = self.n_action_steps, self.replan_interval, self.latency_steps
        check_at_least(1, chunk_size=self.chunk_size, n_action_steps=used, replan_interval=interval)
        check_at_least(0, latency_steps=latency)
        if used > self.chunk_size:
            raise ConfigurationError(
                f"n_action_steps={used} exceeds the {self.chunk_size} control steps of a chunk: "
                f"only predicted actions can be executed: set n_action_steps={self.chunk_size} or less"
            )
        if self.execution == "open_loop":
            self._check_open_loop()
        elif interval >= used:
            raise ConfigurationError(
                f"execution={self.execution} needs overlapping chunks: replan_interval={interval} must be "
                f"below n_action_steps={used}: set {self._ways_to_overlap()}"
            )
        elif interval + latency > used:
            raise ConfigurationError(
                f"replan_interval={interval} + latency_steps={latency} exceeds n_action_steps={used}: the "
                f"old chunk would end before the new one can be used{self._replan_by(used - latency)}"
            )
        elif interval + latency == used and self.execution in _BLENDING:
            raise ConfigurationError(
                f"execution={self.execution} has nothing to blend: replan_interval={interval} + "
                f"latency_steps={latency} must be below n_action_steps={used}, so that two chunks overlap"
                f"{self._replan_by(used - latency - 1)}"
            )

    def _ways_to_overlap(self) -> str:
        """What was meant by a chunk that no newer one overlaps."""
        to_its_end = "execution=open_loop and replan_interval=null to run each chunk to its end"
        if self.n_action_steps > 1:
            return f"replan_interval=null for the default, or {to_its_end}"
        if self.chunk_size == 1:
            return to_its_end
        return f"n_action_steps=null and replan_interval=1 to replan at every step, or {to_its_end}"

    def _replan_by(self, latest: int) -> str:
        """The way out by an earlier replan, if it is not too late for any."""
        return f": set replan_interval={latest} or less" if latest >= 1 else ""

    def _check_open_loop(self) -> None:
        earlier = self.replan_interval < self.n_action_steps
        if self.replan_interval != self.n_action_steps:
            raise ConfigurationError(
                f"execution=open_loop runs each chunk to its end: replan_interval={self.replan_interval} "
                f"must equal n_action_steps={self.n_action_steps}: set replan_interval=null"
                + (", or execution=receding to replan earlier" if earlier else "")
            )
        if self.latency_steps or self.background:
            what = f"during latency_steps={self.latency_steps}" if self.latency_steps else "in the meantime"
            raise ConfigurationError(
                f"execution=open_loop leaves nothing to execute {what}"
                f"{', background=true' if self.background else ''}: "
                "set execution=receding or execution=crossfade"
            )

    def _check_ranges(self) -> None:
        overlap = self.n_action_steps - self.replan_interval - self.latency_steps
        fade, scale, samples = self.crossfade_steps, self.adaptive_scale, self.n_samples
        if fade is not None and not 1 <= fade <= overlap:
            raise ConfigurationError(
                f"crossfade_steps={fade} must be between 1 and the overlap of two chunks, n_action_steps - "
                f"replan_interval - latency_steps = {overlap}"
            )
        self._check_smoothing()
        check_positive(adaptive_scale=scale)
        if samples is not None and samples < 2:
            raise ConfigurationError(f"n_samples={samples} leaves nothing to choose from: at least 2")
        if any(dim < 0 for dim in self.gripper_dims) or len(set(self.gripper_dims)) < len(self.gripper_dims):
            raise ConfigurationError(
                f"gripper_dims={list(self.gripper_dims)} must be distinct indices from 0 on"
            )

    def _check_smoothing(self) -> None:
        steps = self.smoothing_steps
        check_at_least(1, smoothing_steps=steps)
        if steps % 2 == 0:
            raise ConfigurationError(
                f"smoothing_steps={steps} must be odd: a mean over an even number of steps would shift the "
                f"motion by half a step: set smoothing_steps={steps - 1} or smoothing_steps={steps + 1}"
            )
        if steps > self.chunk_size:
            raise ConfigurationError(
                f"smoothing_steps={steps} exceeds the {self.chunk_size} control steps of a chunk: about a "
                "tenth of a second is enough: set smoothing_steps=5 at 50 control steps per second"
            )

    @property
    def weight_growth(self) -> float:
        """By how much a prediction's log weight grows per step of age; negative if new ones weigh more."""
        coeff = self.temporal_ensemble_coeff or 0.0
        return -coeff if self.ensemble_weighting == "recency" else coeff

    @property
    def overlapping_chunks(self) -> int:
        """The most chunks that cover one step."""
        return math.ceil((self.n_action_steps - self.latency_steps) / self.replan_interval)
