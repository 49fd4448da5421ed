"""The whole diagnosis, from what is asked to the report."""

from typing import Any

from lerobot.envs.configs import EnvConfig
from lerobot.utils.constants import ACTION

from act_chunking_runtime.number_checks import check_positive
from lerobot_act_chunking.diagnostics.core.environments import environment_of
from lerobot_act_chunking.diagnostics.core.measures import measure_of
from lerobot_act_chunking.diagnostics.core.report import with_untrained
from lerobot_act_chunking.diagnostics.core.training import dataset_features, read_training, untrained
from lerobot_act_chunking.diagnostics.core.worlds import open_worlds
from lerobot_act_chunking.diagnostics.steps.grid import Cell, make_grid
from lerobot_act_chunking.diagnostics.steps.measuring import Progress, Scale, run_sweep
from lerobot_act_chunking.diagnostics.steps.notes import notes_on
from lerobot_act_chunking.diagnostics.steps.report import StepsReport
from lerobot_act_chunking.diagnostics.steps.results import Sweep
from lerobot_act_chunking.diagnostics.steps.settings import Settings, tolerance_of
from lerobot_act_chunking.diagnostics.steps.sources import hold_out
from lerobot_act_chunking.diagnostics.steps.subject import (
    POLICY_TYPE,
    PolicySubject,
    executed_steps,
    load_steppable,
    own_cell,
)
from lerobot_act_chunking.diagnostics.steps.success import SuccessOfCell, cells_to_run, success_by_steps
from lerobot_act_chunking.diagnostics.steps.verdict import judge
from lerobot_act_chunking.policies.loading import read_config

FIRST_SEED = 1000
"""Of the episodes that are run."""


def diagnose(
    settings: Settings, progress: Progress | None = None, running: Progress | None = None
) -> StepsReport:
    """Sweep a checkpoint's samplers and step counts on held-out observations, and judge its own.

    Args:
        settings: what is asked.
        progress: called with network evaluations done and planned.
        running: called with episodes done and planned, if any are run.

    Raises:
        ConfigurationError: a checkpoint without steps, settings that make no sense, an environment that
            cannot be made, or no tolerance for actions that are not ALOHA's.
        DatasetError: no usable dataset.
        FeatureError: the dataset or the environment lacks what the policy observes.
    """
    check_positive(tolerance=settings.tolerance)
    _check_tolerance(settings)
    policy = load_steppable(settings.checkpoint)
    config = policy.policy.config
    env_config = _environment(settings, config)
    configured = own_cell(config)
    grid = make_grid(policy.policy.process, configured, samplers=settings.samplers, steps=settings.steps)
    n_steps = executed_steps(config.execution_settings)
    held_out = hold_out(
        settings.dataset,
        settings.checkpoint,
        config,
        n_steps=n_steps,
        episodes=settings.episodes,
        observations=settings.observations,
    )
    tolerance = tolerance_of(settings.tolerance, held_out.measure)
    subject = PolicySubject.observing(policy, held_out.observations, n_steps)
    scale = Scale(tolerance=tolerance, seed=settings.seed)
    sweep = run_sweep(subject, grid, held_out.demonstrated, held_out.measure, scale, progress)
    judgement = judge(sweep, grid.own, tolerance, held_out.measure.unit)
    judgement = with_untrained(judgement, untrained(settings.checkpoint))
    return StepsReport(
        requested=settings,
        settings=_as_executed(config, n_steps),
        own=grid.own,
        held_out=held_out,
        tolerance=tolerance,
        sweep=sweep,
        judgement=judgement,
        notes=notes_on(sweep, judgement, held_out, configured, grid.own),
        success=None if env_config is None else _success(settings, env_config, grid.own, sweep, running),
    )


def _check_tolerance(settings: Settings) -> None:
    """Refuse a missing tolerance before anything is loaded, if the dataset that is asked about is here.

    Raises:
        ConfigurationError: it is needed.
    """
    config = read_config(settings.checkpoint)
    if settings.tolerance is not None or config.type != POLICY_TYPE:
        return
    folder = settings.dataset or read_training(settings.checkpoint, config).folder
    action = dataset_features(folder).get(ACTION)
    if action is not None:
        tolerance_of(None, measure_of(action))


def _as_executed(config: Any, n_steps: int) -> dict[str, Any]:
    names = ("type", "objective", "denoiser", "prediction_type", "horizon", "chunk_stride", "sampler")
    names += ("num_inference_steps", "timestep_spacing", "execution")
    return {**{name: getattr(config, name) for name in names}, "executed_steps": n_steps}


def _environment(settings: Settings, config: Any) -> EnvConfig | None:
    """Made once at the start: what is missing shows before the sweep, not after it."""
    if settings.environment is None:
        return None
    env_config = environment_of(config, settings.environment, settings.checkpoint)
    open_worlds(env_config, 1, config).close()
    return env_config


def _success(
    settings: Settings, env_config: EnvConfig, own: Cell, sweep: Sweep, running: Progress | None
) -> list[SuccessOfCell]:
    return success_by_steps(
        settings.checkpoint,
        cells_to_run(own, [result.cell for result in sweep.cells]),
        env_config,
        seeds=range(FIRST_SEED, FIRST_SEED + settings.success_seeds),
        progress=running,
    )
