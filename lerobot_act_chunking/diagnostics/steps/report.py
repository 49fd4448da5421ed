"""Everything the diagnosis found, as one object: the command prints it, JSON holds it, plots draw it."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from lerobot.utils.constants import ACTION

from lerobot_act_chunking.diagnostics.core import outcome
from lerobot_act_chunking.diagnostics.core.checks import check_positive
from lerobot_act_chunking.diagnostics.core.measures import Measure, measure_of
from lerobot_act_chunking.diagnostics.core.training import dataset_features, read_training, untrained
from lerobot_act_chunking.diagnostics.steps import plateau
from lerobot_act_chunking.diagnostics.steps.grid import Cell, make_grid
from lerobot_act_chunking.diagnostics.steps.results import CellResult, Sweep
from lerobot_act_chunking.diagnostics.steps.sources import HeldOut, hold_out
from lerobot_act_chunking.diagnostics.steps.subject import (
    POLICY_TYPE,
    PolicySubject,
    executed_steps,
    load_steppable,
    own_cell,
)
from lerobot_act_chunking.diagnostics.steps.success import SuccessOfCell
from lerobot_act_chunking.diagnostics.steps.sweep import Progress, Scale, run_sweep
from lerobot_act_chunking.diagnostics.steps.verdict import Judgement, judge
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.loading import read_config

DEFAULT_TOLERANCE_MM = 0.5

TOO_WIDE = (
    "What helps a model that spreads: more training or demonstrations of the contact, a demonstrator who "
    "repeats it more exactly, an observation that shows what decides there."
)
NOT_CONVERGING = (
    "The network answers differently at neighbouring noise levels, and the last ones it is asked at, which "
    "depend on the number of steps, decide. More training makes its answers agree; their distance to the "
    "demonstrations says which steps to use meanwhile."
)
SEEN = "The policy was trained on these episodes: its distance to the demonstrations is flattering."
ONE_MODE = "Samples for one observation form one mode: there are no mode flips to leave out."
SEVERAL_MODES = (
    "{share} of the observations have several modes. Pairs that end in different ones are counted as flips, "
    "not as errors; few steps starve rare modes."
)
STOCHASTIC = (
    "The policy samples with {sampler}, which draws noise at every step: two step counts cannot be compared "
    "sample by sample, so {own} stands for it."
)


@dataclass(frozen=True)
class Request:
    """What to measure.

    Attributes:
        checkpoint: a `diffusion_chunked` checkpoint.
        dataset: a LeRobotDataset's folder; None for the one it was trained on.
        episodes: how many to hold out, from the last one backwards.
        observations: how many to take from them.
        tolerance: differences that do not matter; None for half a millimetre where actions are ALOHA's.
        samplers: which to sweep; all by default.
        steps: step counts; `grid.STEPS` by default.
        seed: of the noise.
    """

    checkpoint: str
    dataset: str | None = None
    episodes: int = 10
    observations: int = 256
    tolerance: float | None = None
    samplers: tuple[str, ...] = ()
    steps: tuple[int, ...] = ()
    seed: int = 0


@dataclass(frozen=True)
class StepsReport:
    """The answer to: are these denoising steps enough, and would more help?

    Attributes:
        settings: how the policy samples and executes.
        own: the cell that is judged.
    """

    request: Request
    settings: dict[str, Any]
    own: Cell
    held_out: HeldOut
    tolerance: float
    sweep: Sweep
    judgement: Judgement
    notes: list[str]
    success: list[SuccessOfCell] | None = None

    @property
    def unit(self) -> str:
        """Of all distances."""
        return self.held_out.measure.unit

    @property
    def exit_code(self) -> int:
        """Of the command: 0 pass or warn, 1 fail, 2 inconclusive."""
        return outcome.EXIT_CODES[self.judgement.verdict]

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dictionaries; None for what was not measured."""
        judgement = self.judgement
        recommended = judgement.recommended
        return {
            "tool": "steps",
            "version": version("lerobot_policy_act_chunking"),
            "checkpoint": self.request.checkpoint,
            "policy_type": self.settings["type"],
            "settings": self.settings,
            "dataset": self.held_out.dataset,
            "episodes": self.held_out.episodes,
            "seen_in_training": self.held_out.seen_in_training,
            "n_observations": self.sweep.n_observations,
            "n_near_contact": self.sweep.n_near_contact,
            "fps": self.held_out.fps,
            "seed": self.request.seed,
            "verdict": judgement.verdict,
            "reasons": judgement.reasons,
            "thresholds": self._thresholds(),
            "unit": self.unit,
            "own": asdict(self.own),
            "limit": judgement.limit,
            "recommended": recommended and {**asdict(recommended), "flags": recommended.flags},
            "reference": asdict(self.sweep.reference),
            "series": [asdict(series) for series in judgement.series],
            "cells": [_flat(result) for result in self.sweep.cells],
            "success": self.success and [each.to_json() for each in self.success],
            "notes": self.notes,
        }

    def _thresholds(self) -> dict[str, float]:
        return {
            "tolerance": self.tolerance,
            "same_demonstration_error": plateau.SAME_DEMONSTRATION_ERROR,
            "no_improvement": plateau.NO_IMPROVEMENT,
            "model_limited_from": plateau.BY_FAR * self.tolerance,
            "below_spread": plateau.BELOW_SPREAD,
            "not_converged": plateau.NOT_CONVERGED,
        }

    def write_json(self, path: Path) -> Path:
        """Write `to_json` to a file, creating its folder."""
        return outcome.write_json(self.to_json(), path)


def diagnose(request: Request, progress: Progress | None = None) -> StepsReport:
    """Sweep a checkpoint's samplers and step counts on held-out observations, and judge its own.

    Args:
        request: what to measure.
        progress: called with network evaluations done and planned.

    Raises:
        ConfigurationError: a checkpoint without steps, settings that make no sense, or no tolerance for
            actions that are not ALOHA's.
        DatasetError: no usable dataset.
        FeatureError: the dataset lacks what the policy observes.
    """
    check_positive(tolerance=request.tolerance)
    _check_tolerance(request)
    policy = load_steppable(request.checkpoint)
    config = policy.policy.config
    configured = own_cell(config)
    grid = make_grid(policy.policy.process, configured, samplers=request.samplers, steps=request.steps)
    n_steps = executed_steps(config.execution_settings)
    held_out = hold_out(
        request.dataset,
        request.checkpoint,
        config,
        n_steps=n_steps,
        episodes=request.episodes,
        observations=request.observations,
    )
    tolerance = _tolerance(request.tolerance, held_out.measure)
    subject = PolicySubject.observing(policy, held_out.observations, n_steps)
    scale = Scale(tolerance=tolerance, seed=request.seed)
    sweep = run_sweep(subject, grid, held_out.demonstrated, held_out.measure, scale, progress)
    judgement = judge(sweep, grid.own, tolerance, held_out.measure.unit)
    verdict, reasons = outcome.with_untrained(
        judgement.verdict, judgement.reasons, untrained(request.checkpoint)
    )
    judgement = replace(judgement, verdict=verdict, reasons=reasons)
    return StepsReport(
        request=request,
        settings=_settings(config, n_steps),
        own=grid.own,
        held_out=held_out,
        tolerance=tolerance,
        sweep=sweep,
        judgement=judgement,
        notes=_notes(sweep, judgement, held_out, configured, grid.own),
    )


def _check_tolerance(request: Request) -> None:
    """Refuse a missing tolerance before anything is loaded, if the dataset that is asked about is here.

    Raises:
        ConfigurationError: it is needed.
    """
    config = read_config(request.checkpoint)
    if request.tolerance is not None or config.type != POLICY_TYPE:
        return
    folder = request.dataset or read_training(request.checkpoint, config).folder
    action = dataset_features(folder).get(ACTION)
    if action is not None:
        _tolerance(None, measure_of(action))


def _tolerance(asked: float | None, measure: Measure) -> float:
    if asked is not None:
        return asked
    if measure.unit != "mm":
        raise ConfigurationError(
            "these actions are not ALOHA's 14 joints, so there is no distance in millimetres: say with "
            "--tolerance how much of a difference in raw action units does not matter"
        )
    return DEFAULT_TOLERANCE_MM


def _settings(config: Any, n_steps: int) -> dict[str, Any]:
    names = ("type", "objective", "denoiser", "prediction_type", "horizon", "chunk_stride", "sampler")
    names += ("num_inference_steps", "timestep_spacing", "execution")
    return {**{name: getattr(config, name) for name in names}, "executed_steps": n_steps}


def _notes(sweep: Sweep, judgement: Judgement, held_out: HeldOut, configured: Cell, own: Cell) -> list[str]:
    counts = sweep.reference.mode_counts
    share = f"{1 - counts[0] / sum(counts):.0%}"
    rules: list[tuple[bool, Callable[[], str]]] = [
        (sweep.reference.separation is None, lambda: ONE_MODE),
        (sweep.reference.separation is not None, lambda: SEVERAL_MODES.format(share=share)),
        (configured.sampler != own.sampler, lambda: STOCHASTIC.format(sampler=configured.sampler, own=own)),
        (held_out.seen_in_training, lambda: SEEN),
        (judgement.limit == plateau.SPREAD, lambda: TOO_WIDE),
        (judgement.limit == plateau.CONVERGENCE, lambda: NOT_CONVERGING),
    ]
    return [note() for applies, note in rules if applies]


def _flat(result: CellResult) -> dict[str, Any]:
    content = asdict(result)
    return {**content.pop("cell"), **content}
