"""Two processes train as one with the double batch does: LeRobot's own training, every loss compared.

    OMP_NUM_THREADS=1 python benchmarks/processes.py [--steps 50] [--only CASE ...] [--out FILE]

LeRobot's command trains every case, without dropout, on episodes of different lengths: one process in batches
of 8, two (CPU, gloo) in batches of 4, and from halfway of the two one again. Compared are the losses of all
steps, the frames that the batches held, and the weights at the end.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from rich.console import Console
from safetensors.torch import load_file

from lerobot_act_chunking.data.quiet import quiet_missing_ffmpeg

RESULTS = Path(__file__).parent / "results" / "processes.json"
BATCH = 8
"""Of all processes together; the dataset holds whole batches, so that no epoch ends in a smaller one."""
LENGTHS = (9, 14, 18, 23, 27, 37)
SEED = 0
CAMERA, SIZE = "observation.images.top", (20, 24, 3)
RUNS = {"one": 1, "two": 2, "resumed": 1}
"""Processes of each run; the last goes on where the second was halfway."""
ACT = (
    "--policy.type=act_chunked --policy.chunk_size=8 --policy.dim_model=32 --policy.n_heads=2 "
    "--policy.dropout=0"
)
DIFFUSION = "--policy.type=diffusion_chunked --policy.horizon=8 --policy.dim_model=32 --policy.n_layers=2"
VQBET = (
    "--policy.type=vqbet_chunked --policy.chunk_size=8 --policy.gpt_hidden_dim=32 --policy.gpt_n_layer=2 "
    "--policy.gpt_n_head=2 --policy.dropout=0 --policy.vqvae_n_embed=8 --policy.n_vqvae_training_steps=20"
)
SEEING = "--policy.vision_backbone=small_cnn --policy.crop_shape=[16,20]"
CASES = {
    "act_chunked": f"{ACT} --policy.use_vae=false",
    "act_chunked: latent, averaged weights": (
        f"{ACT} --policy.use_vae=true --policy.use_ema=true --policy.free_bits=0.1"
    ),
    "act_chunked: camera, past, prefix": (
        f"{ACT} --policy.use_vae=false {SEEING} --policy.random_shift=2 --policy.n_obs_steps=3 "
        "--policy.history_dropout=0.3 --policy.prefix_steps=3"
    ),
    "diffusion_chunked": DIFFUSION,
    "diffusion_chunked: camera, unet, ddpm": (
        f"{DIFFUSION} {SEEING} --policy.denoiser=unet1d --policy.down_dims=[16] --policy.objective=ddpm"
    ),
    "vqbet_chunked: tokenizer first": VQBET,
    "vqbet_chunked: tokenizer beside": f"{VQBET} --policy.tokenizer_training=joint --policy.use_ema=false",
}


def record(root: Path, *, camera: bool) -> None:
    """Episodes of random motions, with a small camera or without."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    features = {
        "action": {"dtype": "float32", "shape": (4,), "names": None},
        "observation.state": {"dtype": "float32", "shape": (6,), "names": None},
    }
    if camera:
        features[CAMERA] = {"dtype": "image", "shape": SIZE, "names": ["height", "width", "channels"]}
    dataset = LeRobotDataset.create("local/processes", 10, features, root=root, use_videos=False)
    generator = np.random.default_rng(SEED)
    for length in LENGTHS:
        motion = generator.normal(size=(length, 10)).cumsum(0).astype(np.float32)
        for row in motion:
            seen = {CAMERA: generator.integers(256, size=SIZE, dtype=np.uint8)} if camera else {}
            dataset.add_frame({"action": row[:4], "observation.state": row[4:], **seen, "task": "wander"})
        dataset.save_episode()
    dataset.finalize()


def arguments(folder: Path, run: str, case: str, steps: int) -> list[str]:
    """What ``lerobot-train`` is called with."""
    output, settings = folder_of(folder, run, case), CASES[case]
    batch = f"--output_dir={output} --batch_size={BATCH // RUNS[run]}"
    if run == "resumed":
        checkpoint = folder_of(folder, "two", case) / f"checkpoints/{steps // 2:06d}"
        return f"--config_path={checkpoint}/pretrained_model/train_config.json --resume=true {batch}".split()
    data = (
        f"--dataset.root={folder / ('camera' if SEEING in settings else 'state')} --dataset.repo_id=local/it"
    )
    length = f"--steps={steps} --save_freq={steps // 2} --log_freq=0 --seed={SEED} --num_workers=0"
    policy = f"--policy.device=cpu --policy.push_to_hub=false --policy.lr_warmup_steps=5 {settings}"
    return f"{data} {length} {batch} {policy}".split()


def folder_of(folder: Path, run: str, case: str) -> Path:
    """Where a run of a case is written to."""
    return folder / run / str(list(CASES).index(case))


class Recorder:
    """The losses of a training and the frames of its batches, of all processes together."""

    def __init__(self):
        self.losses: list[float] = []
        self.frames: list[list[int]] = []

    def around(self, update: Any) -> Any:
        """LeRobot's ``update_policy``, watched."""

        def update_policy(metrics: Any, policy: Any, batch: Any, *rest: Any, **kwargs: Any) -> Any:
            accelerator = kwargs["accelerator"]
            self.frames.append(accelerator.gather(batch["index"]).tolist())
            metrics, output = update(metrics, policy, batch, *rest, **kwargs)
            loss = torch.tensor(metrics.loss.val, dtype=torch.float64)
            self.losses.append(accelerator.reduce(loss, "mean").item())
            return metrics, output

        return update_policy


def work(folder: Path, run: str, cases: list[str], steps: int) -> None:
    """Train these cases, in this process and in those beside it that torchrun has started."""
    from accelerate import Accelerator
    from lerobot.scripts import lerobot_train

    quiet_missing_ffmpeg()
    Accelerator.end_training = lambda self: None  # the next case goes on with the same processes
    update = lerobot_train.update_policy
    for case in cases:
        recorder = Recorder()
        lerobot_train.update_policy = recorder.around(update)
        sys.argv = ["lerobot-train", *arguments(folder, run, case, steps)]
        lerobot_train.main()
        if os.environ.get("RANK", "0") == "0":
            found = {"losses": recorder.losses, "frames": recorder.frames}
            (folder_of(folder, run, case) / "found.json").write_text(json.dumps(found))


def launch(folder: Path, run: str, cases: list[str], steps: int) -> None:
    """`work` in as many processes as the run has."""
    torchrun = ["-m", "torch.distributed.run", "--standalone", f"--nproc_per_node={RUNS[run]}"]
    mine = [__file__, "--worker", str(folder), run, "--steps", str(steps), "--only", *cases]
    command = [sys.executable, *(torchrun if RUNS[run] > 1 else []), *mine]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(done.stderr[-4000:])


def compared(folder: Path, case: str) -> dict[str, Any]:
    """How far the other runs are from that of one process."""
    one = Run.of(folder_of(folder, "one", case))
    first_epoch = one.frames[: sum(LENGTHS) // BATCH]
    others = {run: folder_of(folder, run, case) for run in RUNS if run != "one"}
    return {
        "case": case,
        "first_loss": one.losses[0],
        "last_loss": one.losses[-1],
        "frames_seen_twice": first_epoch.size - len(np.unique(first_epoch)),
        "apart": {run: one.apart(Run.of(each)) for run, each in others.items()},
    }


@dataclass(frozen=True)
class Run:
    """What is known of a training: the loss and the frames of each step, and the weights at the end."""

    losses: np.ndarray
    frames: np.ndarray
    weights: dict[str, torch.Tensor]

    @classmethod
    def of(cls, folder: Path) -> Self:
        """The training that has been written to ``folder``."""
        found = json.loads((folder / "found.json").read_text())
        weights = load_file(folder / "checkpoints/last/pretrained_model/model.safetensors")
        return cls(np.array(found["losses"]), np.array(found["frames"]), weights)

    def apart(self, other: Self) -> dict[str, Any]:
        """The largest differences; of losses above 1 relative to them."""
        n_steps = len(other.losses)
        losses = self.losses[-n_steps:]
        weights = [
            (self.weights[name].double() - value.double()).abs().max()
            for name, value in other.weights.items()
        ]
        return {
            "loss": float((abs(losses - other.losses) / np.maximum(1, losses)).max()),
            "weights": float(max(weights)),
            "same_frames": bool((self.frames[-n_steps:] == other.frames).all()),
        }


def table(results: Mapping[str, Any]) -> str:
    """The table of docs/guides/several-machines.md."""
    lines = [
        "| | first loss | last loss | two: losses differ by | weights at the end | one goes on: losses |",
        "|---|---|---|---|---|---|",
    ]
    for each in results["cases"]:
        two, resumed = each["apart"]["two"], each["apart"]["resumed"]
        lines.append(
            f"| {each['case']} | {each['first_loss']:.3f} | {each['last_loss']:.3f} | {two['loss']:.0e} | "
            f"{two['weights']:.0e} | {resumed['loss']:.0e} |"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--steps", type=int, default=50)
    parser.add_argument("--only", nargs="+", choices=CASES, default=list(CASES), metavar="CASE")
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--worker", nargs=2, metavar=("FOLDER", "RUN"), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.worker is not None:
        folder, run = args.worker
        work(Path(folder), run, args.only, args.steps)
        return
    quiet_missing_ffmpeg()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for kind in ("camera", "state"):
            record(folder / kind, camera=kind == "camera")
        for run in RUNS:
            launch(folder, run, args.only, args.steps)
        cases = [compared(folder, case) for case in args.only]
    names = ("torch", "lerobot", "accelerate")
    results = {
        "settings": {"steps": args.steps, "batch_size": BATCH, "seed": SEED, "episode_lengths": LENGTHS},
        "versions": {"python": platform.python_version(), **{name: version(name) for name in names}},
        "cases": cases,
    }
    args.out.write_text(json.dumps(results, indent=1) + "\n")
    Console().print(table(results), soft_wrap=True, markup=False)


if __name__ == "__main__":
    main()
