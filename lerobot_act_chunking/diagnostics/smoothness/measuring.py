"""From episodes to a `SmoothnessReport`."""

from collections.abc import Callable, Sequence

import numpy as np

from lerobot_act_chunking.data.dimension_names import is_hand
from lerobot_act_chunking.diagnostics.core import motion_metrics as metrics
from lerobot_act_chunking.diagnostics.core.noise_floor import NoiseFloor
from lerobot_act_chunking.diagnostics.core.rollouts import Rollout
from lerobot_act_chunking.diagnostics.core.tracking import Tracking, track
from lerobot_act_chunking.diagnostics.core.trajectories import UndefinedMeasureError
from lerobot_act_chunking.diagnostics.smoothness import chunks
from lerobot_act_chunking.diagnostics.smoothness.report import (
    Curves,
    DisagreementReport,
    MotionMeasures,
    SignalReport,
    SmoothnessReport,
)
from lerobot_act_chunking.envs.aloha.tasks import JOINT_NAMES
from lerobot_act_chunking.errors import DatasetError, FeatureError

FEWEST_EPISODES = 2
FEWEST_STEPS = 4
STD_FLOOR = 0.1
"""Without demonstrations that say which joints move, units are at least this share of the widest std.

Its own std, zero or a tiny number, would turn its slightest tremor into the largest motion of all.
"""

NO_DIMENSION = {
    "arms": "no dimension moves but those of grippers and hands",
    "grippers": "no dimension that moves has a name with gripper, hand, finger or thumb in it",
}


def measure(
    rollouts: Sequence[Rollout],
    *,
    action_std: np.ndarray,
    joint_names: Sequence[str] = JOINT_NAMES,
    latency_steps: int = 0,
    name: str = "",
    knows_success: bool = True,
    floor: NoiseFloor | None = None,
    notes: Sequence[str] = (),
) -> SmoothnessReport:
    """Measure how smooth some episodes are.

    Args:
        rollouts: the episodes. Inferences without chunks count as boundaries only; positions of width 0
            leave the achieved motion out.
        action_std: of the training data, ``(A,)``: what counts as 1 in each dimension (but see `STD_FLOOR`);
            the same for all that is compared.
        joint_names: of the A dimensions; grippers are those that `is_hand` takes for one.
        latency_steps: control steps after an inference at which its chunk is first used.
        name: what to call the source.
        knows_success: whether the rollouts' ``success`` means anything.
        floor: of the demonstrations: dimensions that do not move there are in no group. None: all are.
        notes: what to know about the source.

    Raises:
        DatasetError: fewer than two episodes, or values that are not finite.
        FeatureError: commands, positions, names and ``action_std`` differ in width.
    """
    action_std = np.asarray(action_std, float)
    _check(rollouts, action_std, joint_names)
    study = _Study(rollouts, action_std, joint_names, latency_steps, floor)
    tracking = study.tracking()
    inferences = sum(len(rollout.inferences) for rollout in rollouts)
    return SmoothnessReport(
        name=name,
        episodes=len(rollouts),
        steps=sum(len(rollout.commands) for rollout in rollouts),
        dt=rollouts[0].dt,
        successes=sum(rollout.success for rollout in rollouts) if knows_success else None,
        network_calls_per_episode=inferences / len(rollouts) if inferences else None,
        boundaries_per_episode=sum(map(len, study.commanded.boundaries)) / len(rollouts),
        commanded=study.signal_report(study.commanded),
        achieved=None if study.achieved is None else study.signal_report(study.achieved),
        boundary_to_plan_ratio=study.boundary_to_plan(),
        moving=[joint_names[dim] for dim in study.moving],
        tracking_lag_s={
            name: lag and lag.seconds for name, lag in (tracking.groups | tracking.joints).items()
        },
        lag_correlation={name: lag and lag.correlation for name, lag in tracking.joints.items()},
        lag_groups=tracking.alike,
        disagreement=study.disagreement(),
        curves=study.curves(),
        undefined=study.undefined,
        notes=[*notes, *study.notes],
    )


class _Signal:
    """Commanded or achieved trajectories of all episodes, in standard deviations."""

    def __init__(self, name: str, motions: list[np.ndarray], boundaries: list[np.ndarray], dt: float):
        self.name = name
        self.motions = motions
        self.boundaries = boundaries
        self.dt = dt
        self.frequencies, self.power = metrics.velocity_spectrum(motions, dt)

    def speeds(self, dims: Sequence[int]) -> list[np.ndarray]:
        return [metrics.speed(motion[:, dims], self.dt) for motion in self.motions]


class _Study:
    """The measures of one source, and the reasons why some are undefined."""

    def __init__(
        self,
        rollouts: Sequence[Rollout],
        std: np.ndarray,
        joint_names: Sequence[str],
        latency_steps: int,
        floor: NoiseFloor | None,
    ):
        self.rollouts = rollouts
        self.moving = list(range(len(joint_names))) if floor is None else floor.moving
        self.scale = std.clip(min=STD_FLOOR * std.max()) if floor is None else np.where(std > 0, std, 1.0)
        self.latency_steps = latency_steps
        self.undefined: dict[str, str] = {}
        self.notes: list[str] = [] if floor is None else floor.notes
        grippers = [dim for dim, name in enumerate(joint_names) if is_hand(name)]
        arms = [dim for dim in self.moving if dim not in grippers]
        self.groups = {"arms": arms, "grippers": [dim for dim in grippers if dim in self.moving]}
        self.joints = {name: [dim] for dim, name in enumerate(joint_names)}
        starts = [chunks.boundary_steps(rollout, latency_steps) for rollout in rollouts]
        self.commanded = self._signal("commanded", starts)
        # Positions are those before a step's command acts: it shows one step later.
        known = rollouts[0].positions.size > 0
        self.achieved = self._signal("achieved", [start + 1 for start in starts]) if known else None
        if self.achieved is None:
            self.undefined["achieved"] = "the source holds no joint positions beside the commands"

    def _signal(self, name: str, boundaries: list[np.ndarray]) -> _Signal:
        attribute = "commands" if name == "commanded" else "positions"
        motions = [getattr(rollout, attribute) / self.scale for rollout in self.rollouts]
        return _Signal(name, motions, boundaries, self.rollouts[0].dt)

    def value(self, path: str, compute: Callable[[], float]) -> float | None:
        """A measure, or None and its reason in `undefined`."""
        try:
            return compute()
        except UndefinedMeasureError as reason:
            self.undefined[path] = str(reason)
            return None

    def signal_report(self, signal: _Signal) -> SignalReport:
        groups = {name: self._measures(signal, name, dims, 1.0) for name, dims in self.groups.items()}
        joints = {
            name: self._measures(signal, f"joints.{name}", dims, float(self.scale[dims[0]]))
            for name, dims in self.joints.items()
        }
        return SignalReport(**groups, joints=joints)

    def _measures(self, signal: _Signal, path: str, dims: list[int], unit: float) -> MotionMeasures:
        """Measures of some dimensions; ``unit`` takes jerk from standard deviations to the joint's unit."""
        if not dims:
            self.undefined[f"{signal.name}.{path}"] = NO_DIMENSION[path]
            return MotionMeasures(*[None] * 6)
        motions = [motion[:, dims] for motion in signal.motions]
        speeds = signal.speeds(dims)
        starts, dt = signal.boundaries, signal.dt
        computations = {
            "rms_jerk": lambda: unit * metrics.rms_jerk(motions, dt),
            "log_dimensionless_jerk": lambda: metrics.median(
                metrics.per_episode(metrics.log_dimensionless_jerk, speeds, dt)
            ),
            "sparc": lambda: metrics.median(metrics.per_episode(metrics.spectral_arc_length, speeds, dt)),
            "boundary_ratio": lambda: chunks.boundary_ratio(motions, starts),
            "boundary_acceleration_ratio": lambda: chunks.boundary_ratio(motions, starts, order=2),
            "energy_above_5_hz": lambda: metrics.high_frequency_share(
                signal.frequencies, signal.power[:, dims]
            ),
        }
        prefix = f"{signal.name}.{path}"
        return MotionMeasures(
            **{name: self.value(f"{prefix}.{name}", compute) for name, compute in computations.items()}
        )

    def boundary_to_plan(self) -> dict[str, float | None]:
        return {
            name: self.value(
                f"boundary_to_plan_ratio.{name}",
                lambda dims=dims: chunks.boundary_to_plan_ratio(
                    self.rollouts, dims, self.scale, self.latency_steps
                ),
            )
            for name, dims in self.groups.items()
            if dims
        }

    def tracking(self) -> Tracking:
        achieved = [] if self.achieved is None else self.achieved.motions
        groups = {name: dims for name, dims in self.groups.items() if dims}
        found = track(
            self.commanded.motions, achieved, self.commanded.dt, list(self.joints), groups, self.moving
        )
        self.undefined |= {f"tracking_lag_s.{name}": reason for name, reason in found.undefined.items()}
        if found.note is not None:
            self.notes.append(found.note)
        return found

    def disagreement(self) -> DisagreementReport | None:
        try:
            found = chunks.disagreement(self.rollouts, self.scale)
        except UndefinedMeasureError as reason:
            self.undefined["disagreement"] = str(reason)
            return None
        if not self.groups["arms"]:
            self.undefined["disagreement"] = NO_DIMENSION["arms"]
            return None
        arms, grippers = self.groups["arms"], self.groups["grippers"]
        return DisagreementReport(
            ages_s=(found.ages * self.commanded.dt).tolist(),
            arms=found.rms(arms).tolist(),
            grippers=found.rms(grippers).tolist() if grippers else None,
            joints={name: found.rms(dims).tolist() for name, dims in self.joints.items()},
            pairs=found.pairs.tolist(),
            mean_arms=float(found.rms(arms).mean()),
        )

    def curves(self) -> Curves:
        arms, commanded = self.groups["arms"], self.commanded
        motions = [motion[:, arms] for motion in commanded.motions]
        try:
            profile = chunks.boundary_profile(motions, commanded.boundaries).tolist()
        except UndefinedMeasureError as reason:
            self.undefined["curves.boundary_profile"] = str(reason)
            profile = None
        return Curves(
            frequencies_hz=commanded.frequencies.tolist(),
            commanded_power=commanded.power[:, arms].sum(1).tolist(),
            achieved_power=None if self.achieved is None else self.achieved.power[:, arms].sum(1).tolist(),
            boundary_profile=profile,
            log_dimensionless_jerk=metrics.per_episode(
                metrics.log_dimensionless_jerk, commanded.speeds(arms), commanded.dt
            ),
        )


def _check(rollouts: Sequence[Rollout], action_std: np.ndarray, joint_names: Sequence[str]) -> None:
    if len(rollouts) < FEWEST_EPISODES:
        raise DatasetError(f"smoothness needs at least {FEWEST_EPISODES} episodes, got {len(rollouts)}")
    width = (len(joint_names),)
    for rollout in rollouts:
        shapes = rollout.commands.shape[1:], action_std.shape
        if shapes != (width, width) or rollout.positions.shape[1:] not in (width, (0,)):
            raise FeatureError(
                f"{len(joint_names)} joint names, but commands are {rollout.commands.shape}, positions "
                f"{rollout.positions.shape} and action_std {action_std.shape}"
            )
        if len(rollout.commands) < FEWEST_STEPS:
            raise DatasetError(
                f"episode {rollout.seed} has {len(rollout.commands)} steps; a third derivative needs "
                f"{FEWEST_STEPS}"
            )
        if not (np.isfinite(rollout.commands).all() and np.isfinite(rollout.positions).all()):
            raise DatasetError(f"episode {rollout.seed} holds commands or positions that are not finite")
