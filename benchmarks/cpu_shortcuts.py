"""What each shortcut of `nn.cpu` saves: `act_chunked` trains a step and plans a chunk, with and without it.

Both are the same policy in the same process, in turns, and all other shortcuts stay on. Measured is the CPU
time of all threads, so that other programs hardly count. Printed are medians, and the median of the paired
ratios (below 1: the shortcut saves time). A shortcut that saves less than 4 % everywhere is not worth its
lines: the committed results have three more, which were removed for them.

    python benchmarks/cpu_shortcuts.py [--repeats 20] [--output benchmarks/results/cpu_shortcuts.json]
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import torch
from paired_timing import medians
from policy import CASES, Case, make_batch, make_policies, new_chunk, training_step
from torch import Tensor, nn

from lerobot_act_chunking.nn.cpu.attention import CpuAttention
from lerobot_act_chunking.nn.cpu.linear import Linear
from lerobot_act_chunking.nn.style_encoder import StyleEncoder

CHUNK, STEP = "new chunk", "training step"
BASE, PAPER, SMALL = "base, act's default", "state d512 vae", "state d128 vae"
BY_NAME = {case.name: case for case in CASES}


@dataclass(frozen=True)
class Shortcut:
    """What takes its place, and where it is in use.

    Attributes:
        name: as printed.
        plain: (class, method, its plain form).
        used: (case, quantity).
    """

    name: str
    plain: tuple[type, str, Callable[..., Any]]
    used: Sequence[tuple[str, str]]

    @contextmanager
    def off(self) -> Iterator[None]:
        """Without this shortcut."""
        owner, method, plain = self.plain
        with patch.object(owner, method, plain):
            yield


@dataclass(frozen=True)
class Result:
    """Median CPU times in milliseconds, and the median of the paired ratios with / without."""

    shortcut: str
    case: str
    quantity: str
    without_ms: float
    with_ms: float
    ratio: float


def embed_plainly(encoder: StyleEncoder, actions: Tensor, state: Tensor | None) -> Tensor:
    """Class token, state and actions as tokens."""
    parts = [encoder.cls.expand(len(actions), 1, -1)]
    if encoder.state_proj is not None and state is not None:
        parts.append(encoder.state_proj(state[:, None]))
    return torch.cat([*parts, encoder.action_proj(actions)], dim=1)


SHORTCUTS = (
    Shortcut(
        "products of a few rows",
        (Linear, "forward", nn.Linear.forward),
        [(PAPER, CHUNK), (BASE, CHUNK)],
    ),
    Shortcut(
        "queries on the keys' side",
        (CpuAttention, "factored_is_cheaper", lambda self, n_queries, n_keys: False),
        [(PAPER, CHUNK), (PAPER, STEP)],
    ),
    Shortcut(
        "embedded actions as a span",
        (StyleEncoder, "_embed", embed_plainly),
        [(PAPER, STEP), (SMALL, STEP)],
    ),
)


def cpu_milliseconds(call: Callable[[], object]) -> float:
    """CPU time of one call, of all threads."""
    start = time.process_time()
    call()
    return 1e3 * (time.process_time() - start)


def compare(call: Callable[[], object], shortcut: Shortcut, repeats: int) -> tuple[float, float, float]:
    """Without and with, in turns that each begin with the other one, after an untimed turn."""
    turns = []
    for turn in range(repeats + 1):
        times = {}
        for off in (True, False) if turn % 2 else (False, True):
            with ExitStack() as stack:
                if off:
                    stack.enter_context(shortcut.off())
                times[off] = cpu_milliseconds(call)
        turns.append((times[True], times[False]))
    return medians(turns[1:])


def measure(shortcut: Shortcut, case: Case, quantity: str, repeats: int, batch_size: int | None) -> Result:
    """One shortcut in one place."""
    torch.manual_seed(0)
    _, policy = make_policies(case)
    if quantity == STEP:
        call = training_step(policy, make_batch(case, batch_size or case.batch_size))
    else:
        call, repeats = new_chunk(policy, make_batch(case, 1)), 5 * repeats
    return Result(shortcut.name, case.name, quantity, *compare(call, shortcut, repeats))


def main() -> None:
    parser = argparse.ArgumentParser(description="What each shortcut of nn.cpu saves.")
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--batch-size", type=int, help="of training steps; default: as benchmarks/policy.py")
    parser.add_argument("--only", default="", help="measure the shortcuts whose name contains this")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    results = []
    print(f"{'shortcut':30}{'case':22}{'quantity':16}{'without ms':>12}{'with ms':>12}{'ratio':>8}")
    for shortcut in SHORTCUTS:
        if options.only in shortcut.name:
            for case, quantity in shortcut.used:
                found = measure(shortcut, BY_NAME[case], quantity, options.repeats, options.batch_size)
                results.append(found)
                print(
                    f"{found.shortcut:30}{found.case:22}{found.quantity:16}"
                    f"{found.without_ms:12.2f}{found.with_ms:12.2f}{found.ratio:8.3f}",
                    flush=True,
                )
    if options.output:
        options.output.write_text(json.dumps([asdict(result) for result in results], indent=2) + "\n")


if __name__ == "__main__":
    main()
