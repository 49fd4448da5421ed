"""Reading chunks for training: fast chunks beside LeRobot's reader, paired in one run.

    python benchmarks/dataset_reader.py [--rounds 5] [--episodes 50] [--threads 2] [--out dataset_reader.json]

A dataset like the quickstart's is drawn at random: states of 14, object poses of 7, actions of 14 numbers,
chunks of 100 steps. Both readers take turns at the same samples, so that a busy machine slows both; ratios
are taken within a round. The share is what fetching and preprocessing a batch (LeRobot's ``data_s``) takes of
a whole step of training the quickstart's policy.
"""

import argparse
import json
import os
import platform
import statistics
import tempfile
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import datasets
import numpy as np
import torch
import yaml
from lerobot.configs import FeatureType
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies import make_pre_post_processors
from lerobot.utils.feature_utils import dataset_to_policy_features
from rich.console import Console
from rich.table import Table
from torch.utils.data import DataLoader

from lerobot_act_chunking.data.fast_chunks.dataset import FastChunkDataset
from lerobot_act_chunking.data.quiet import quiet_missing_ffmpeg
from lerobot_act_chunking.policies.act_chunked.configuration_act_chunked import ActChunkedConfig
from lerobot_act_chunking.policies.act_chunked.modeling_act_chunked import ActChunkedPolicy

FPS, FRAMES, CHUNK, BATCH = 50, 320, 100, 64
SIZES = {"observation.state": 14, "observation.environment_state": 7, "action": 14}
QUICKSTART = Path(__file__).parents[1] / "configs" / "quickstart.yaml"
DATA, STEP = "batch, preprocessed", "step of training"
READERS: dict[str, type[LeRobotDataset]] = {"LeRobot": LeRobotDataset, "fast": FastChunkDataset}


def record(root: Path, episodes: int) -> None:
    """Random numbers take as long to read as demonstrations."""
    features = {key: {"dtype": "float32", "shape": (size,), "names": None} for key, size in SIZES.items()}
    dataset = LeRobotDataset.create("bench/reader", FPS, features, root=root)
    rng = np.random.default_rng(0)
    for _ in range(episodes):
        for _ in range(FRAMES):
            values = {key: rng.standard_normal(size, np.float32) for key, size in SIZES.items()}
            dataset.add_frame({**values, "task": "cube"})
        dataset.save_episode()
    dataset.finalize()


def training(dataset: LeRobotDataset) -> tuple[Callable[[dict], dict], Callable[[dict], None]]:
    """LeRobot's preprocessing of a batch, and one step of training on it."""
    features = dataset_to_policy_features(dataset.meta.features)
    outputs = {key: feature for key, feature in features.items() if feature.type is FeatureType.ACTION}
    inputs = {key: feature for key, feature in features.items() if key not in outputs}
    settings = yaml.safe_load(QUICKSTART.read_text())["policy"]
    del settings["type"]
    config = ActChunkedConfig(input_features=inputs, output_features=outputs, **settings)
    preprocess, _ = make_pre_post_processors(config, dataset_stats=dataset.meta.stats)
    policy = ActChunkedPolicy(config)
    optimizer = config.get_optimizer_preset().build(policy.get_optim_params())

    def step(batch: dict) -> None:
        policy.forward(batch)[0].backward()
        torch.nn.utils.clip_grad_norm_(policy.parameters(), 10.0)
        optimizer.step()
        optimizer.zero_grad()

    return preprocess, step


def milliseconds(call: Callable[[], Any], repeats: int = 1) -> float:
    start = time.perf_counter()
    for _ in range(repeats):
        call()
    return 1e3 * (time.perf_counter() - start) / repeats


def measure(root: Path, rounds: int) -> dict[str, dict[str, list[float]]]:
    """Milliseconds by quantity and reader, one per round; the first round, which warms up, is dropped."""
    offsets = {"action": [step / FPS for step in range(CHUNK)]}
    readers = {name: cls("bench/reader", root, delta_timestamps=offsets) for name, cls in READERS.items()}
    preprocess, step = training(readers["fast"])
    rng = np.random.default_rng(1)
    times: dict[str, dict[str, list[float]]] = {}

    def note(quantity: str, reader: str, value: float) -> None:
        times.setdefault(quantity, {}).setdefault(reader, []).append(value)

    for _ in range(rounds + 1):
        order = rng.permutation(len(readers["fast"])).tolist()
        for name, dataset in readers.items():
            repeats = 1 if name == "LeRobot" else 20
            samples, batches = iter(order), iter(DataLoader(dataset, BATCH, sampler=order))
            next(batches)
            note("one sample", name, milliseconds(lambda d=dataset, s=samples: d[next(s)], 10 * repeats))
            note(f"batch of {BATCH}", name, milliseconds(lambda b=batches: next(b), repeats))
            note(DATA, name, milliseconds(lambda b=batches: preprocess(next(b)), repeats))
        batch = preprocess(next(batches))
        note(STEP, "fast", milliseconds(lambda b=batch: step(dict(b)), 3))
    return {quantity: {name: values[1:] for name, values in by.items()} for quantity, by in times.items()}


def summarise(times: dict[str, dict[str, list[float]]]) -> dict[str, dict[str, float]]:
    summary = {}
    step = statistics.median(times.pop(STEP)["fast"])
    for quantity, by in times.items():
        ratios = [theirs / ours for theirs, ours in zip(by["LeRobot"], by["fast"], strict=True)]
        medians = {f"{name}_ms": statistics.median(values) for name, values in by.items()}
        summary[quantity] = {**medians, "ratio": statistics.median(ratios), "ratio_min": min(ratios)}
    data = summary[DATA]
    summary[STEP] = {
        "ms": step,
        **{f"{r}_share": data[f"{r}_ms"] / (data[f"{r}_ms"] + step) for r in READERS},
    }
    return summary


def table(summary: dict[str, dict[str, float]]) -> Table:
    shown = Table("", "LeRobot", "fast", "ratio", "worst", title=f"reading {CHUNK}-step chunks")
    for quantity, row in summary.items():
        if quantity == STEP:
            shares = (f"{row[f'{reader}_share']:.1%}" for reader in READERS)
            shown.add_row(f"share of a step ({row['ms']:.1f} ms)", *shares)
        else:
            times = (f"{row[f'{reader}_ms']:.3f} ms" for reader in READERS)
            shown.add_row(quantity, *times, f"{row['ratio']:.0f}", f"{row['ratio_min']:.0f}")
    return shown


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--episodes", type=int, default=50, help=f"of {FRAMES} frames")
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--out", type=Path, default=Path("dataset_reader.json"))
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    quiet_missing_ffmpeg()
    datasets.disable_progress_bars()
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "dataset"
        record(root, options.episodes)
        summary = summarise(measure(root, options.rounds))
    Console().print(table(summary))
    versions = {name: version(name) for name in ("lerobot", "datasets", "torch", "numpy")}
    machine = {"cpus": os.cpu_count(), "system": platform.platform(), "python": platform.python_version()}
    settings = {"rounds": options.rounds, "episodes": options.episodes, "threads": options.threads}
    report = {"summary": summary, "settings": settings, "versions": versions, "machine": machine}
    options.out.write_text(json.dumps(report, indent=2) + "\n")


if __name__ == "__main__":
    main()
