"""Time per control step of chunk execution, beside LeRobot's temporal ensembler, paired in one run.

    python benchmarks/execution.py [--rounds 15] [--threads 1] [--out execution.json]

Chunks of 100 steps and 14 dimensions are predicted in no time: what is measured is what becomes of them. Both
sides get the same tensors and take turns; ratios are taken within a round. Times are this process's CPU time,
which on one thread is what a step takes when nothing else runs, whatever else does.
LeRobot's `ACTTemporalEnsembler` can only take a chunk at every step. A step of ours is the whole of
`ChunkExecutor.step`, which also finds out for which environments a chunk is due.
"""

import argparse
import json
import os
import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

import torch
from lerobot.policies.act.modeling_act import ACTTemporalEnsembler
from rich.console import Console
from rich.table import Table

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.execution.executor import ChunkExecutor

CHUNK, DIMS, STEPS = 100, 14, 200
BATCH_SIZES = (1, 8, 64)
MODES: dict[str, dict] = {
    "ensemble, R=1": {"execution": "ensemble", "replan_interval": 1},
    "ensemble, R=10": {"execution": "ensemble", "replan_interval": 10},
    "ensemble, R=50": {"execution": "ensemble", "replan_interval": 50},
    "open_loop": {"execution": "open_loop"},
    "receding, R=50": {"execution": "receding", "replan_interval": 50},
    "crossfade, R=50": {"execution": "crossfade", "replan_interval": 50},
    "coherence, R=50": {"execution": "coherence", "replan_interval": 50},
    "adaptive gate, R=10": {"execution": "adaptive", "replan_interval": 10, "adaptive_kernel": "gate"},
    "adaptive gate, R=50": {"execution": "adaptive", "replan_interval": 50, "adaptive_kernel": "gate"},
    "adaptive cosine, R=50": {"execution": "adaptive", "replan_interval": 50, "adaptive_kernel": "cosine"},
    "adaptive gaussian, R=50": {
        "execution": "adaptive",
        "replan_interval": 50,
        "adaptive_kernel": "gaussian",
    },
}


@dataclass(frozen=True)
class Result:
    """Microseconds per control step of the whole batch, and ours / LeRobot's within a round."""

    mode: str
    batch_size: int
    ours_us: float
    ours_best_us: float
    lerobot_us: float
    lerobot_best_us: float
    ratio: float


def ours(settings: dict, chunk: torch.Tensor) -> Callable[[], None]:
    executor = ChunkExecutor(ExecutionSettings(CHUNK, **settings))
    samples = executor.settings.n_samples
    prediction = chunk if samples is None else chunk + 0.1 * torch.randn(samples, *chunk.shape)

    def steps() -> None:
        for _ in range(STEPS):
            executor.step(lambda _: prediction, len(chunk))

    return steps


def lerobots(chunk: torch.Tensor) -> Callable[[], None]:
    ensembler = ACTTemporalEnsembler(0.01, CHUNK)

    def steps() -> None:
        for _ in range(STEPS):
            ensembler.update(chunk)

    return steps


def microseconds(steps: Callable[[], None]) -> float:
    start = time.process_time()
    steps()
    return 1e6 * (time.process_time() - start) / STEPS


def compare(mode: str, batch_size: int, rounds: int) -> Result:
    """Time both in turns, after one untimed turn, which also fills them with chunks."""
    chunk = torch.randn(batch_size, CHUNK, DIMS, generator=torch.Generator().manual_seed(0))
    theirs, own = lerobots(chunk), ours(MODES[mode], chunk)
    pairs = [(microseconds(theirs), microseconds(own)) for _ in range(rounds + 1)][1:]
    lerobot_times, own_times = zip(*pairs, strict=True)
    return Result(
        mode=mode,
        batch_size=batch_size,
        ours_us=statistics.median(own_times),
        ours_best_us=min(own_times),
        lerobot_us=statistics.median(lerobot_times),
        lerobot_best_us=min(lerobot_times),
        ratio=statistics.median(own / lerobot for lerobot, own in pairs),
    )


def table(results: list[Result]) -> Table:
    title = f"microseconds per control step, chunks of {CHUNK} x {DIMS}: median (best)"
    shown = Table("mode", title=title)
    for column in ("batch", "LeRobot's ensembler", "ours", "ratio", "of batch 1, per environment"):
        shown.add_column(column, justify="right")
    single = {result.mode: result.ours_us for result in results if result.batch_size == 1}
    for result in results:
        shown.add_row(
            result.mode,
            str(result.batch_size),
            f"{result.lerobot_us:.1f} ({result.lerobot_best_us:.1f})",
            f"{result.ours_us:.1f} ({result.ours_best_us:.1f})",
            f"{result.ratio:.2f}",
            f"{result.ours_us / result.batch_size / single[result.mode]:.2f}",
            end_section=result.batch_size == BATCH_SIZES[-1],
        )
    return shown


def main() -> None:
    parser = argparse.ArgumentParser(description="Compare chunk execution with LeRobot's ensembler.")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("execution.json"))
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    with torch.inference_mode():
        results = [compare(mode, size, options.rounds) for mode in MODES for size in BATCH_SIZES]
    Console(width=120).print(table(results))
    versions = {name: version(name) for name in ("lerobot", "torch", "numpy")}
    machine = {"cpus": os.cpu_count(), "system": platform.platform(), "python": platform.python_version()}
    settings = {"rounds": options.rounds, "threads": options.threads, "steps": STEPS, "modes": MODES}
    report = {"results": [asdict(r) for r in results], "settings": settings}
    options.out.write_text(json.dumps(report | {"versions": versions, "machine": machine}, indent=2) + "\n")


if __name__ == "__main__":
    main()
