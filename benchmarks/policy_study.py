"""Training policies as users do, letting them act on the same episodes, and writing down what came of it.

What benchmarks/act_success.py, diffusion_success.py, vqbet_success.py and fetch.py share. Every training
and every evaluation is written down when it is done, so that a study can be stopped and gone on with, and
several may run side by side.
"""

import argparse
import json
import statistics
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from execution_study import FEWEST_SUCCESSES, FIRST_SEED, smoothness
from policy_training import Recording, Training, Variant
from rich.console import Console
from rich.table import Table

from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate
from lerobot_act_chunking.durable_files import write_atomically
from lerobot_act_chunking.envs.robotics.tasks import TASKS as ROBOTICS_TASKS
from lerobot_act_chunking.errors import ActChunkingError

if TYPE_CHECKING:
    from torch.nn import Module

    from lerobot_act_chunking.diagnostics.core.rollouts import Rollout

TIMED_CHUNKS, N_ENVS = 30, 50
COUNTED = {
    "act": "model.encoder",
    "act_chunked": "model.encoder",
    "diffusion": "diffusion.unet",
    "diffusion_chunked": "model.denoiser",
    "vqbet": "vqbet.policy",
    "vqbet_chunked": "model.gpt",
}
"""The part of each policy whose calls are counted."""


@dataclass(frozen=True)
class Run:
    """What is evaluated: one training's checkpoint, and settings of sampling other than the trained ones."""

    task: str
    variant: str
    seed: int = 0
    checkpoint: str = "last"
    sampling: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Cell:
    """One evaluation.

    Attributes:
        run: what was evaluated: task, variant, training seed, checkpoint and sampling.
        train: of the whole training: steps, minutes on the clock, minutes of CPU, parameters.
        failed_seeds: also those in which the simulation diverged under the policy's commands.
        network_calls: per chunk.
        chunk_ms: of CPU, from one observation to its chunk, median.
        threads: that PyTorch used.
        smoothness: of the arms' commands in successful episodes; empty if they are few.
    """

    run: dict[str, Any]
    train: dict[str, Any]
    episodes: int
    failed_seeds: list[int]
    network_calls: int
    chunk_ms: float
    threads: int
    smoothness: dict[str, float | None] = field(default_factory=dict)

    @property
    def rate(self) -> SuccessRate:
        """The success rate."""
        return SuccessRate(self.episodes - len(self.failed_seeds), self.episodes)


def evaluate(training: Training, asked: Run, episodes: int) -> Cell:
    """One cell."""
    import torch

    from lerobot_act_chunking.diagnostics.core.environments import environment_of, task_environment

    loaded = load(training, asked)
    rule = "final" if asked.task in ROBOTICS_TASKS else "touch"
    env_config: Any = environment_of(loaded.policy.config, task_environment(asked.task, rule))
    milliseconds, calls = time_chunks(loaded, env_config)
    seeds = range(FIRST_SEED, FIRST_SEED + episodes)
    groups = [seeds[first : first + N_ENVS] for first in range(0, episodes, N_ENVS)]
    succeeded = [each for group in groups for each in act(loaded, env_config, group) if each.success]
    return Cell(
        run=asdict(asked),
        train=training.facts,
        episodes=episodes,
        failed_seeds=sorted({*seeds} - {each.seed for each in succeeded}),
        network_calls=calls,
        chunk_ms=milliseconds,
        threads=torch.get_num_threads(),
        smoothness=smoothness(succeeded, loaded, env_config.action_names)
        if len(succeeded) >= FEWEST_SUCCESSES
        else {},
    )


def load(training: Training, asked: Run) -> Any:
    """The policy with its settings of sampling; LeRobot's are executed otherwise through the wrapper."""
    from lerobot_act_chunking.policies.loading import load_policy
    from lerobot_act_chunking.policies.temporal_ensemble.wrapping import load_wrapped

    path = training.checkpoints / asked.checkpoint / "pretrained_model"
    if training.variant.is_lerobot and asked.sampling:
        return load_wrapped(str(path), **asked.sampling)
    loaded = load_policy(path)
    for name, value in asked.sampling.items():
        setattr(loaded.policy.config, name, value)
    return loaded


def act(loaded: Any, env_config: Any, seeds: Sequence[int]) -> "list[Rollout]":
    """The episodes; without those in which the policy's commands make the simulation diverge."""
    from lerobot_act_chunking.diagnostics.core.rollouts import roll_out

    try:
        return roll_out(loaded, env_config, seeds, n_envs=len(seeds))
    except ActChunkingError:
        half = len(seeds) // 2
        return act(loaded, env_config, seeds[:half]) + act(loaded, env_config, seeds[half:]) if half else []


def time_chunks(loaded: Any, env_config: Any) -> tuple[float, int]:
    """Median milliseconds of CPU from one observation to its chunk, and the network's calls in it.

    CPU time, so that whoever else computes does not count.
    """
    import gymnasium as gym
    import torch
    from lerobot.envs.utils import preprocess_observation

    make = lambda: gym.make(env_config.gym_id, disable_env_checker=True, **env_config.gym_kwargs)  # noqa: E731
    envs = gym.vector.SyncVectorEnv([make])
    observation, _ = envs.reset(seed=[FIRST_SEED])
    envs.close()
    policy = loaded.policy
    batch = loaded.preprocessor(preprocess_observation(observation) | {"task": [""]})
    calls, seconds = [], []
    with torch.inference_mode():
        policy.reset()
        policy.select_action(dict(batch))  # fills LeRobot's history of observations
        counting = counted_part(policy).register_forward_hook(lambda *_: calls.append(1))
        for _ in range(TIMED_CHUNKS):
            started = time.process_time()
            policy.predict_action_chunk(dict(batch))
            seconds.append(time.process_time() - started)
    counting.remove()
    return 1000 * statistics.median(seconds), len(calls) // TIMED_CHUNKS


def counted_part(policy: Any) -> "Module":
    """The part whose calls are counted, of the averaged network if that is the one that acts."""
    policy = getattr(policy, "inner", policy)
    path = COUNTED[policy.name]
    averaged = getattr(policy, "ema", None) is not None
    return policy.get_submodule(path.replace("model.", "ema.network.") if averaged else path)


class Results:
    """All finished cells, on disk as soon as they are known; several processes may write different ones."""

    def __init__(self, folder: Path):
        self.folder = folder

    def path(self, asked: Run) -> Path:
        sampling = "_".join(str(value) for value in asked.sampling.values()) or "trained"
        return (
            self.folder
            / asked.task
            / asked.variant
            / f"seed_{asked.seed}"
            / f"{asked.checkpoint}_{sampling}.json"
        )

    def get(self, asked: Run) -> Cell | None:
        path = self.path(asked)
        return Cell(**json.loads(path.read_text())) if path.exists() else None

    def add(self, asked: Run, cell: Cell) -> None:
        write_atomically(self.path(asked), json.dumps(asdict(cell)).encode())


@dataclass(frozen=True)
class Study:
    """Policies on tasks.

    Attributes:
        folder: for trainings and evaluations.
        recordings: folder of the demonstrations, which are made first where they are not there yet.
        variants: the policies, by their names in runs.
        console: to print to.
        operators: who demonstrates; the expert as it is if nobody.
        demonstrations: how many, of each task.
    """

    folder: Path
    recordings: Path
    variants: Mapping[str, Variant]
    console: Console
    operators: tuple[str, ...] = ()
    demonstrations: int | None = None

    def cells(self, runs: Iterable[Run], episodes: int) -> list[Cell]:
        """The cells of these runs, made where they are not there yet."""
        return [self._cell(asked, episodes) for asked in runs]

    def _cell(self, asked: Run, episodes: int) -> Cell:
        results = Results(self.folder)
        cell = results.get(asked)
        if cell is None:
            variant = self.variants[asked.variant]
            recording = Recording(
                self.recordings, asked.task, variant.velocity, self.operators, self.demonstrations
            )
            recording.record(self.console)
            training = Training(results.path(asked).parent, variant, asked.seed, recording)
            training.train(self.console)
            cell = evaluate(training, asked, episodes)
            results.add(asked, cell)
            self.console.print(*row(cell), sep="  ")
        return cell


HEADER = ("task", "policy", "training", "sampling", "calls", "success %", "95 % Wilson", "jerk", "ms")


def row(cell: Cell) -> list[str]:
    """A cell in a table."""
    asked, rate, jerk = Run(**cell.run), cell.rate, cell.smoothness.get("rms_jerk")
    trained = f"seed {asked.seed}, {cell.train['steps']} steps, {cell.train['cpu_minutes']:.1f} CPU min"
    return [
        asked.task,
        asked.variant,
        trained + (f", at {asked.checkpoint}" if asked.checkpoint != "last" else ""),
        " ".join(str(value) for value in asked.sampling.values()) or "as trained",
        str(cell.network_calls),
        f"{100 * rate.rate:.1f}",
        rate.percent,
        f"{jerk:.3g}" if jerk else "-",
        f"{cell.chunk_ms:.1f}",
    ]


def report(title: str, cells: Sequence[Cell], path: Path, console: Console) -> None:
    """Print the cells as a table and write them down."""
    table = Table(*HEADER, title=title)
    for cell in cells:
        table.add_row(*row(cell))
    console.print(table)
    path.write_text(json.dumps([asdict(cell) for cell in cells], indent=1) + "\n")


def run_studies(
    name: str,
    description: str,
    studies: Mapping[str, Callable[[str], Iterable[Run]]],
    variants: Mapping[str, Variant],
    *,
    tasks: Sequence[str] = ("transfer_cube", "insertion"),
    recordings: str = "quickstart",
) -> None:
    """The command line of a benchmark.

    Args:
        name: of its files.
        description: for ``--help``.
        studies: by name, what is run for a task.
        variants: the policies, by their names in runs.
        tasks: to run unless others are asked for.
        recordings: name of the benchmark whose demonstrations are learned from.
    """
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--studies", nargs="+", choices=studies, default=list(studies))
    parser.add_argument("--tasks", nargs="+", default=list(tasks))
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--folder", type=Path, default=Path(f"outputs/benchmarks/{name}"))
    parser.add_argument("--recordings", type=Path, default=Path("outputs/benchmarks") / recordings)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    args = parser.parse_args()
    console = Console(width=160)
    study = Study(args.folder, args.recordings, variants, console)
    for title in args.studies:
        runs = [asked for task in args.tasks for asked in studies[title](task)]
        cells = study.cells(runs, args.episodes)
        report(title, cells, args.out / f"{name}_{title}.json", console)
