"""Data time and training steps with cameras: the frame cache beside LeRobot's reader, in one run.

    OMP_NUM_THREADS=1 python benchmarks/frame_cache.py [--recordings ../shared/data] [--out FILE]

Batches of the recordings with videos, read by LeRobot, by this package without a cache, with an empty cache
(frames are decoded and stored) and with a full one, as they are and at 240 x 320. All take turns at the same
samples, so that a busy machine slows all of them. A second camera for `g1` is made by copying its videos:
other files of the same size, which cost what a second camera of 480 x 640 costs.

Then training steps of 8 samples with those two cameras, in turns as well, in CPU time. Backbones start from
random weights: which weights they are does not change the time of a step.
"""

import argparse
import json
import os
import platform
import shutil
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import datasets
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import torch
from lerobot.configs import FeatureType
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from lerobot.utils.constants import IMAGENET_STATS
from lerobot.utils.feature_utils import dataset_to_policy_features
from rich.console import Console
from rich.table import Table
from torch.utils.data import default_collate

from lerobot_act_chunking.data.fast_chunks.dataset import FastChunkDataset
from lerobot_act_chunking.data.fast_chunks.frames import cache, filling
from lerobot_act_chunking.data.fast_chunks.reading import Reading
from lerobot_act_chunking.data.quiet import quiet_missing_ffmpeg
from lerobot_act_chunking.policies.act_chunked.configuration_act_chunked import ActChunkedConfig

CAMERA, SECOND = "observation.images.cam_high", "observation.images.cam_second"
TWO = "g1, two cameras"
SMALL = (240, 320)
BATCHES = (8, 64)
STEP_BATCH = 8
LEROBOT, UNCACHED, EMPTY = "LeRobot", "no cache", "empty cache"
FULL, FULL_SMALL = "full cache", "full, 240x320"
READERS = (LEROBOT, UNCACHED, EMPTY, FULL, FULL_SMALL)
Times = dict[str, list[float]]


def with_second_camera(source: Path, target: Path) -> Path:
    """A copy of a recording in which another camera has copies of the first one's videos."""
    shutil.copytree(source, target)
    shutil.copytree(target / "videos" / CAMERA, target / "videos" / SECOND)
    info = json.loads((target / "meta/info.json").read_text())
    info["features"][SECOND] = info["features"][CAMERA]
    (target / "meta/info.json").write_text(json.dumps(info))
    stats = json.loads((target / "meta/stats.json").read_text())
    (target / "meta/stats.json").write_text(json.dumps(stats | {SECOND: stats[CAMERA]}))
    for file in (target / "meta/episodes").rglob("*.parquet"):
        episodes = pq.read_table(file)
        for name in [each for each in episodes.column_names if CAMERA in each]:
            episodes = episodes.append_column(name.replace(CAMERA, SECOND), episodes[name])
        pq.write_table(pa.table(episodes), file)
    return target


def opened(root: Path, name: str, folder: Path) -> LeRobotDataset:
    """A dataset as this reader reads it, for a policy that predicts a second."""
    fps = json.loads((root / "meta/info.json").read_text())["fps"]
    stamps = {"action": [step / fps for step in range(fps)]}
    options: dict[str, Any] = {"root": root, "return_uint8": True}
    if name == LEROBOT:
        return LeRobotDataset(f"local/{root.name}", delta_timestamps=stamps, **options)
    os.environ[cache.FOLDER] = "0" if name == UNCACHED else str(folder / name)
    features = json.loads((root / "meta/info.json").read_text())["features"]
    size = SMALL if name == FULL_SMALL else None
    reading = Reading(stamps, frozenset(features), lambda _: None, None, size)
    return FastChunkDataset(f"local/{root.name}", delta_timestamps=reading, **options)


def fill(dataset: Any) -> float:
    """Fill a dataset's cache as the background does; the seconds it took."""
    reader, start = dataset.reader, time.perf_counter()
    os.environ[cache.FOLDER] = str(store_folders(dataset)[0].parent)
    settings = {
        "repo_id": dataset.repo_id,
        "root": str(dataset.root),
        "tolerance_s": reader._tolerance_s,
        "video_backend": reader._video_backend,
    }
    options = {"dataset": settings, "cameras": list(dataset._frames.stores), "size": dataset._frames.size}
    filling.fill(options, os.getppid())
    return time.perf_counter() - start


def data_times(root: Path, folder: Path, rounds: int) -> dict[str, Any]:
    """Milliseconds per batch by batch size and reader, and what filling the cache took."""
    small = min(min(each["shape"][:2]) for each in cameras_of(root).values()) > SMALL[0]
    names = READERS if small else READERS[:-1]
    readers = {name: opened(root, name, folder) for name in names}
    filled = {name: fill(readers[name]) for name in names if name.startswith("full")}
    order = iter(np.random.default_rng(0).permutation(len(readers[LEROBOT])).tolist())
    times: dict[str, Times] = {}
    for batch in BATCHES:
        for turn in range(rounds + 1):
            rows = [next(order) for _ in range(batch)]
            for name, dataset in readers.items():
                took = milliseconds(lambda d=dataset, r=rows: read(d, r))
                if turn:
                    times.setdefault(f"batch of {batch}", {}).setdefault(name, []).append(took)
    sizes = {name: sum(map(cache._bytes_on_disk, store_folders(readers[name]))) / 1e6 for name in filled}
    return {"ms": times, "filling_s": filled, "cache_mb": sizes, "frames": len(readers[LEROBOT])}


def cameras_of(root: Path) -> dict[str, Any]:
    features = json.loads((root / "meta/info.json").read_text())["features"]
    return {key: each for key, each in features.items() if each["dtype"] == "video"}


def store_folders(dataset: Any) -> list[Path]:
    return [store.folder for store in dataset._frames.stores.values()]


def read(dataset: Any, rows: list[int]) -> dict[str, Any]:
    """What a data loader does for a batch."""
    items = dataset.__getitems__(rows) if hasattr(dataset, "__getitems__") else [dataset[row] for row in rows]
    return default_collate(items)


def milliseconds(call: Callable[[], object], clock: Callable[[], float] = time.perf_counter) -> float:
    start = clock()
    call()
    return 1e3 * (clock() - start)


def trainers(dataset: LeRobotDataset) -> Iterator[tuple[str, Callable[[dict], None]]]:
    """A training step of each policy."""
    common: dict[str, Any] = {"chunk_size": 100, "pretrained_backbone_weights": None}
    yield "LeRobot act, 480x640", trainer(dataset, ACTConfig, **common)
    for size, shown in ((None, "480x640"), (SMALL, "240x320")):
        for backbone in ("resnet18", "efficientnet_lite0"):
            settings = common | {"vision_backbone": backbone, "resize_shape": size}
            yield f"act_chunked {backbone}, {shown}", trainer(dataset, ActChunkedConfig, **settings)


def trainer(dataset: LeRobotDataset, config_class: type, **settings: Any) -> Callable[[dict], None]:
    """LeRobot's training step: bytes to numbers, preprocessing, gradients, an update."""
    features = dataset_to_policy_features(dataset.meta.features)
    outputs = {key: each for key, each in features.items() if each.type is FeatureType.ACTION}
    inputs = {key: each for key, each in features.items() if key not in outputs}
    config = config_class(
        input_features=inputs, output_features=outputs, device="cpu", push_to_hub=False, **settings
    )
    for key in dataset.meta.camera_keys:
        dataset.meta.stats[key] |= {name: torch.tensor(each) for name, each in IMAGENET_STATS.items()}
    preprocess, _ = make_pre_post_processors(config, dataset_stats=dataset.meta.stats)
    policy = get_policy_class(config.type)(config).train()
    optimizer = config.get_optimizer_preset().build(policy.get_optim_params())

    def step(batch: dict) -> None:
        images = {key: batch[key].float() / 255 for key in dataset.meta.camera_keys}
        policy.forward(preprocess({**batch, **images}))[0].backward()
        torch.nn.utils.clip_grad_norm_(policy.parameters(), 10.0)
        optimizer.step()
        optimizer.zero_grad()

    return step


def step_times(root: Path, folder: Path, rounds: int) -> dict[str, dict[str, list[float]]]:
    """CPU milliseconds of reading a batch out of a full cache, and of a training step, by policy."""
    whole, small = (opened(root, name, folder) for name in (FULL, FULL_SMALL))
    steps = dict(trainers(whole))
    rng, times = np.random.default_rng(1), {name: {"data": [], "step": []} for name in steps}
    for turn in range(rounds + 1):
        rows = rng.integers(len(whole), size=STEP_BATCH).tolist()
        for name, step in steps.items():
            source = small if name.endswith("240x320") else whole
            batch: dict[str, Any] = {}
            data = milliseconds(lambda s=source, b=batch, r=rows: b.update(read(s, r)), time.process_time)
            batch |= {"action": pad(batch["action"]), "action_is_pad": pad(batch["action_is_pad"])}
            took = milliseconds(lambda s=step, b=batch: s(b), time.process_time)
            if turn:
                times[name]["data"].append(data)
                times[name]["step"].append(took)
    return times


def pad(values: torch.Tensor) -> torch.Tensor:
    """As many steps as a chunk has, which cost as much as recorded ones."""
    return torch.cat([values] * 4, dim=1)[:, :100]


def summarise(measured: dict[str, Any]) -> dict[str, Any]:
    """Medians of all times."""
    if isinstance(measured, dict):
        return {key: summarise(value) for key, value in measured.items()}
    return round(statistics.median(measured), 2) if isinstance(measured, list) else measured


def show(summary: dict[str, Any]) -> None:
    shown = Table(
        "recording", "batch", LEROBOT, UNCACHED, EMPTY, FULL, FULL_SMALL, title="ms to read a batch"
    )
    for name, result in summary["data"].items():
        for batch, times in result["ms"].items():
            shown.add_row(name, batch, *(f"{times[each]:.1f}" if each in times else "-" for each in READERS))
    Console(width=140).print(shown)
    shown = Table(
        "policy", "data [CPU ms]", "step [CPU ms]", "share of data", title=f"a training step of {STEP_BATCH}"
    )
    for name, times in summary["steps"].items():
        share = times["data"] / (times["data"] + times["step"])
        shown.add_row(name, f"{times['data']:.1f}", f"{times['step']:.0f}", f"{share:.2%}")
    Console(width=140).print(shown)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--recordings", type=Path, default=Path("../shared/data"))
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--step-rounds", type=int, default=3)
    parser.add_argument("--out", type=Path, default=Path("frame_cache.json"))
    options = parser.parse_args()
    quiet_missing_ffmpeg()
    datasets.disable_progress_bars()
    filling.FEW = 10**9  # nothing else runs beside
    torch.manual_seed(0)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        two = with_second_camera(options.recordings / "g1", folder / "g1_two")
        roots = {"cloth": options.recordings / "cloth", "g1": options.recordings / "g1", TWO: two}
        data = {name: data_times(root, folder / "cache", options.rounds) for name, root in roots.items()}
        summary = summarise({"data": data, "steps": step_times(two, folder / "cache", options.step_rounds)})
    show(summary)
    versions = {name: version(name) for name in ("lerobot", "torch", "av", "numpy")}
    machine = {"cpus": os.cpu_count(), "system": platform.platform(), "python": platform.python_version()}
    settings = {
        "rounds": options.rounds,
        "step_rounds": options.step_rounds,
        "threads": torch.get_num_threads(),
    }
    report = {"summary": summary, "settings": settings, "versions": versions, "machine": machine}
    options.out.write_text(json.dumps(report, indent=2) + "\n")


if __name__ == "__main__":
    main()
