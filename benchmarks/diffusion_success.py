"""How well `diffusion_chunked` does its tasks, and with how many steps: the tables of docs/diffusion.md.

    OMP_NUM_THREADS=1 python benchmarks/diffusion_success.py
    OMP_NUM_THREADS=1 python benchmarks/diffusion_success.py --studies variants --tasks insertion

Studies: `recipe` (three training seeds), `lerobot` (LeRobot's `diffusion` on the same data, for as long on
the same core), `variants` (objectives and denoisers) and `steps` (sampler steps against success, jerk and
milliseconds). Every policy is trained by lerobot-train on the recording of benchmarks/quickstart.py (made
first if it is not there) and acts in the same 200 episodes, in `steps` in the first 100 of them. Every
training and every evaluation is written down when it is done, so the studies can be stopped and gone on
with, and may run side by side.
"""

import argparse
import json
import math
import os
import resource
import shutil
import statistics
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from diffusion_variants import RECIPE, STUDIES, VARIANTS, Run, Variant
from execution_study import FEWEST_SUCCESSES, FIRST_SEED, smoothness
from rich.console import Console
from rich.table import Table

from lerobot_act_chunking.cli.quickstart import Story, run
from lerobot_act_chunking.diagnostics.success import SuccessRate
from lerobot_act_chunking.errors import ActChunkingError

if TYPE_CHECKING:
    from lerobot_act_chunking.diagnostics.rollouts import Rollout

TIMED_CHUNKS, N_ENVS = 30, 50
READER = "ACT_CHUNKING_FAST_CHUNKS"
SWEEP_EPISODES = 100


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


@dataclass(frozen=True)
class Training:
    """One policy: its folder, and how it came about."""

    folder: Path
    variant: Variant
    seed: int
    recording: Story

    @property
    def checkpoints(self) -> Path:
        return self.folder / "train" / "checkpoints"

    @cached_property
    def facts(self) -> dict[str, Any]:
        """Steps, minutes and parameters, once trained."""
        return json.loads((self.folder / "training.json").read_text())

    def command(self) -> list[str]:
        """What a user would type."""
        variant, data = self.variant, self.recording
        return [
            "lerobot-train",
            *(f"--policy.{name}={value}" for name, value in variant.policy.items()),
            *(f"--dataset.repo_id={data.repo_id}", f"--dataset.root={data.dataset}"),
            *(f"--output_dir={self.folder / 'train'}", f"--seed={self.seed}"),
            *(f"--steps={variant.steps}", f"--save_freq={max(1, variant.steps // 5)}"),
            f"--log_freq={max(1, variant.steps // 20)}",
            f"--batch_size={RECIPE['batch_size']}",
            *("--num_workers=0", "--env_eval_freq=0", "--wandb.enable=false"),
        ]

    def train(self, console: Console) -> None:
        """Train, unless that was done before; what was interrupted begins again."""
        if (self.folder / "training.json").exists():
            return
        shutil.rmtree(self.folder / "train", ignore_errors=True)
        os.environ[READER] = "0" if self.variant.is_lerobot else "1"
        started, cpu = time.monotonic(), _children_seconds()
        run(self.command(), console)
        facts = {
            "steps": self.variant.steps,
            "minutes": (time.monotonic() - started) / 60,
            "cpu_minutes": (_children_seconds() - cpu) / 60,
            "parameters": _parameters(self.checkpoints / "last"),
        }
        (self.folder / "training.json").write_text(json.dumps(facts, indent=2) + "\n")


def _children_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _parameters(checkpoint: Path) -> int:
    """Numbers that the trained network consists of."""
    from safetensors import safe_open

    with safe_open(checkpoint / "pretrained_model" / "model.safetensors", "pt") as weights:
        names = [name for name in weights.keys() if not name.startswith("training_noise")]  # noqa: SIM118
        return sum(math.prod(weights.get_slice(name).get_shape()) for name in names)


def evaluate(training: Training, asked: Run, episodes: int) -> Cell:
    """One cell."""
    import torch

    from lerobot_act_chunking.diagnostics.rollouts import environment_for
    from lerobot_act_chunking.policies.loading import load_policy

    loaded = load_policy(training.checkpoints / asked.checkpoint / "pretrained_model")
    for name, value in asked.sampling.items():
        setattr(loaded.policy.config, name, value)
    env_config = environment_for(loaded.policy.config, task=asked.task, success="touch")
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
        smoothness=smoothness(succeeded, loaded) if len(succeeded) >= FEWEST_SUCCESSES else {},
    )


def act(loaded: Any, env_config: Any, seeds: Sequence[int]) -> "list[Rollout]":
    """The episodes; without those in which the policy's commands make the simulation diverge."""
    from lerobot_act_chunking.diagnostics.rollouts import roll_out

    try:
        return roll_out(loaded, env_config, seeds, n_envs=len(seeds))
    except ActChunkingError:
        half = len(seeds) // 2
        return act(loaded, env_config, seeds[:half]) + act(loaded, env_config, seeds[half:]) if half else []


def time_chunks(loaded: Any, env_config: Any) -> tuple[float, int]:
    """Median milliseconds of CPU from one observation to its chunk, and the denoiser's calls in it.

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
    denoiser = policy.diffusion.unet if policy.name == "diffusion" else policy.model.denoiser
    calls, seconds = [], []
    with torch.inference_mode():
        policy.reset()
        policy.select_action(dict(batch))  # fills LeRobot's history of observations
        counting = denoiser.register_forward_hook(lambda *_: calls.append(1))
        for _ in range(TIMED_CHUNKS):
            started = time.process_time()
            policy.predict_action_chunk(dict(batch))
            seconds.append(time.process_time() - started)
    counting.remove()
    return 1000 * statistics.median(seconds), len(calls) // TIMED_CHUNKS


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
        part = self.path(asked).with_suffix(".part")
        part.write_text(json.dumps(asdict(cell)))
        part.replace(self.path(asked))


def study(runs: Iterable[Run], folder: Path, recordings: Path, episodes: int, console: Console) -> list[Cell]:
    """All cells, made where they are not there yet."""
    results, cells = Results(folder), []
    for asked in runs:
        variant = VARIANTS[asked.variant]
        cell = results.get(asked)
        if cell is None:
            recording = Story(recordings / asked.task, asked.task)
            if not recording.recorded():
                run(recording.record_command(), console)
            training = Training(results.path(asked).parent, variant, asked.seed, recording)
            training.train(console)
            cell = evaluate(training, asked, episodes)
            results.add(asked, cell)
            console.print(*row(cell), sep="  ")
        cells.append(cell)
    return cells


HEADER = ("task", "policy", "training", "sampling", "calls", "success %", "95 % Wilson", "jerk", "ms")


def row(cell: Cell) -> list[str]:
    """A cell in a table."""
    asked, rate, jerk = Run(**cell.run), cell.rate, cell.smoothness.get("rms_jerk")
    low, high = rate.interval
    trained = f"seed {asked.seed}, {cell.train['steps']} steps, {cell.train['cpu_minutes']:.1f} CPU min"
    return [
        asked.task,
        asked.variant,
        trained + (f", at {asked.checkpoint}" if asked.checkpoint != "last" else ""),
        " ".join(str(value) for value in asked.sampling.values()) or "as trained",
        str(cell.network_calls),
        f"{100 * rate.rate:.1f}",
        f"{100 * low:.1f}-{100 * high:.1f}",
        f"{jerk:.3g}" if jerk else "-",
        f"{cell.chunk_ms:.1f}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--studies", nargs="+", choices=STUDIES, default=list(STUDIES))
    parser.add_argument("--tasks", nargs="+", default=["transfer_cube", "insertion"])
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--folder", type=Path, default=Path("outputs/benchmarks/diffusion"))
    parser.add_argument("--recordings", type=Path, default=Path("outputs/benchmarks/quickstart"))
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    args = parser.parse_args()
    console = Console(width=160)
    for name in args.studies:
        runs = [asked for task in args.tasks for asked in STUDIES[name](task)]
        episodes = min(args.episodes, SWEEP_EPISODES) if name == "steps" else args.episodes
        cells = study(runs, args.folder, args.recordings, episodes, console)
        table = Table(*HEADER, title=name)
        for cell in cells:
            table.add_row(*row(cell))
        console.print(table)
        path = args.out / f"diffusion_{name}.json"
        path.write_text(json.dumps([asdict(cell) for cell in cells], indent=1) + "\n")


if __name__ == "__main__":
    main()
