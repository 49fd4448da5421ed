"""One policy that places a block, spoilt in three ways, and what `act-chunking diagnose` says of each.

    OMP_NUM_THREADS=1 python benchmarks/lecture_case.py

`act_chunked` with a sampled style learns FetchPickAndPlace from two people, one of whom comes from either
side and one of whom rests at every contact. Three versions of it place fewer blocks: one keeps a style for
too long, one gives up its chunks too soon, one averages them for too long. Their failures look alike; the
reports are benchmarks/results/lecture_case_*.json and docs/images/lecture_case_*.png, and
docs/instruments/diagnose.md reads them.
"""

import argparse
import json
import shutil
from pathlib import Path
from typing import Any

from fetch_variants import ACT
from policy_training import Recording, Training, Variant
from rich.console import Console

from lerobot_act_chunking.cli.main import main as act_chunking

TASK, PEOPLE = "FetchPickAndPlace-v4", ("two_sided", "unhurried")
STYLE = {"use_vae": True, "latent_dim": 8, "kl_weight": 0.01, "free_bits": 0.05, "n_vae_encoder_layers": 1}
POLICY = Variant({**ACT, **STYLE, "z_inference": "sample", "z_hold": "chunk"}, 2000, 64)
LIKELIEST = {"z_inference": "mode", "z_hold": "episode"}
VERSIONS: dict[str, dict[str, Any]] = {
    "healthy": {},
    "style": {"z_hold": "steps", "z_hold_steps": 20},
    "chunk": {**LIKELIEST, "replan_interval": 1},
    "smoothing": {
        **LIKELIEST,
        "execution": "ensemble",
        "replan_interval": 1,
        "temporal_ensemble_coeff": 0.1,
    },
}
"""Settings that are changed in the checkpoint."""


def version(checkpoint: Path, folder: Path, settings: dict[str, Any]) -> Path:
    """A copy of the checkpoint with these settings."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(checkpoint, folder)
    config = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps(config | settings, indent=1))
    return folder


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--folder", type=Path, default=Path("outputs/benchmarks/lecture_case"))
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--results", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--pictures", type=Path, default=Path("docs/images"))
    args = parser.parse_args()
    console = Console(width=160)
    recording = Recording(args.folder / "recordings", TASK, operators=PEOPLE)
    recording.record(console)
    training = Training(args.folder / "training", POLICY, 0, recording)
    training.train(console)
    checkpoint = training.checkpoints / "last" / "pretrained_model"
    for name, settings in VERSIONS.items():
        spoilt = version(checkpoint, args.folder / name, settings)
        act_chunking(
            [
                *("diagnose", str(spoilt), "--env.type=gymnasium_robotics", f"--env.task={TASK}"),
                *("--env.velocities=false", "--env.success=final", "--episodes", str(args.episodes)),
                *("--dataset", str(recording.dataset), "--output-dir", str(args.folder / "episodes" / name)),
                *("--json", str(args.results / f"lecture_case_{name}.json")),
                *(("--out", str(args.pictures / f"lecture_case_{name}.png")) if settings else ()),
            ]
        )


if __name__ == "__main__":
    main()
