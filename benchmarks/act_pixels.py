"""`act_chunked` from one camera, and LeRobot's `act` beside it with the same data and minutes.

    OMP_NUM_THREADS=1 python benchmarks/act_pixels.py

Trains both on the recording of benchmarks/vqbet_pixels.py (made first if it is not there): 50 demonstrations
of transfer_cube, one camera of 128 x 96 pixels and the joints' positions. Both act in the same 200 unseen
episodes. Prints a table and draws a success. Every step is skipped if its result is there, so it can be
stopped and gone on with.
"""

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from policy_training import Training, Variant
from rich.console import Console
from vqbet_pixels import (
    LOOKS,
    STAGES,
    TASK,
    Cell,
    SameReader,
    evaluate,
    record,
    show,
)

from lerobot_act_chunking.cli.quickstart import QuickstartPlan

GRASP = 92  # step at which the arm is down at the cube
WAIST = 7  # joint of the arm that grasps: it turns to where the cube lies

RECIPE: dict[str, Any] = yaml.safe_load((Path(__file__).parents[1] / "configs/act_pixels.yaml").read_text())

# As wide and deep as ours, since a step of its default (512 wide, a VAE of four layers) takes many times as
# long; no pretrained weights, since nothing is downloaded, so its backbone needs more than a rate of 1e-5.
LEROBOT: dict[str, Any] = {
    "type": "act",
    "device": "cpu",
    "push_to_hub": False,
    "chunk_size": 100,
    "n_action_steps": LOOKS,
    "dim_model": 128,
    "n_heads": 4,
    "dim_feedforward": 512,
    "n_encoder_layers": 2,
    "use_vae": False,
    "dropout": 0.0,
    "pretrained_backbone_weights": "null",
    "optimizer_lr": 3e-4,
    "optimizer_lr_backbone": 3e-4,
}

VARIANTS = {
    "act_chunked": Variant(RECIPE["policy"], RECIPE["steps"], RECIPE["batch_size"]),
    "LeRobot act": SameReader(LEROBOT, steps=592, batch_size=16),
}
"""With about the same minutes each."""


def left_to_the_camera(plan: QuickstartPlan) -> dict[int, float]:
    """Share of the variance of the waist's command at the grasp that the joints do not tell, per step.

    By ridge regression on four of five episodes, measured on the fifth. Where it is small, no policy needs to
    look.
    """
    import pandas as pd

    table = pd.concat(map(pd.read_parquet, sorted(plan.dataset.glob("data/*/*.parquet"))))
    episodes = [rows for _, rows in table.groupby("episode_index")]
    goal = np.array([rows["action"].iloc[GRASP][WAIST] for rows in episodes])
    held = np.arange(len(episodes)) % 5 == 0
    return {
        step: _unexplained(np.stack([rows["observation.state"].iloc[step] for rows in episodes]), goal, held)
        for step in range(0, GRASP, 10)
    }


def _unexplained(joints: np.ndarray, goal: np.ndarray, held: np.ndarray) -> float:
    mean, spread = joints[~held].mean(0), joints[~held].std(0) + 1e-3
    inputs = np.column_stack([(joints - mean) / spread, np.ones(len(joints))])
    known = inputs[~held]
    weights = np.linalg.solve(known.T @ known + 1e-2 * np.eye(known.shape[1]), known.T @ goal[~held])
    return float(np.mean((goal[held] - inputs[held] @ weights) ** 2) / goal[held].var())


def draw(training: Training, cell: Cell, path: Path) -> None:
    """The first successful episode, larger than the policy saw it; nothing if there is none."""
    from lerobot_act_chunking.diagnostics.core.environments import environment_of, task_environment
    from lerobot_act_chunking.diagnostics.core.rollouts import roll_out
    from lerobot_act_chunking.policies.loading import load_policy

    best = len(STAGES) - 1
    seed = next((seed for seed, stage in sorted(cell.stages.items()) if stage == best), None)
    if seed is None:
        return
    loaded, seen = load_policy(training.checkpoints / "last" / "pretrained_model"), []
    config = environment_of(loaded.policy.config, task_environment(TASK, "touch"))
    (episode,) = roll_out(loaded, config, [seed], on_step=lambda _, step, env: seen.append(env.render()))
    if episode.success:
        _strip(seen, 1 / config.fps, path)


def _strip(frames: list[np.ndarray], dt: float, path: Path, n_shown: int = 6) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    shown = np.linspace(0, len(frames) - 1, n_shown).round().astype(int)
    figure, axes = plt.subplots(2, n_shown // 2, figsize=(9, 4.9), layout="constrained")
    for axis, step in zip(axes.flat, shown, strict=True):
        axis.imshow(frames[step])
        axis.set_title(f"{step * dt:.1f} s", fontsize=10)
        axis.axis("off")
    figure.savefig(path, dpi=110)


def main() -> None:
    """Everything."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--policies", nargs="+", choices=VARIANTS, default=list(VARIANTS))
    parser.add_argument("--folder", type=Path, default=Path("outputs/benchmarks/act_pixels"))
    parser.add_argument("--recording", type=Path, default=Path("outputs/benchmarks/vqbet_pixels"))
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/act_pixels.json"))
    parser.add_argument("--picture", type=Path, default=Path("docs/images/act_pixels.png"))
    args = parser.parse_args()
    console = Console(width=160)
    plan = record(args.recording, console)
    left = left_to_the_camera(plan)
    console.print("left to the camera, at step:", {step: round(share, 3) for step, share in left.items()})
    cells = []
    for name in args.policies:
        training = Training(args.folder / name.replace(" ", "_"), VARIANTS[name], 0, plan)
        training.train(console)
        cells.append(evaluate(name, training, args.episodes))
        if name == "act_chunked":
            draw(training, cells[-1], args.picture)
    show(cells, console)
    result = {"left_to_the_camera": left, "policies": [asdict(cell) for cell in cells]}
    args.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
