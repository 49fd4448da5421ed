"""What benchmarks/fetch.py trains, and how it lets it act."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from policy_study import Run
from policy_training import Variant

RECIPE: dict[str, Any] = yaml.safe_load((Path(__file__).parents[1] / "configs/fetch.yaml").read_text())
POLICY, BATCH = RECIPE["policy"], RECIPE["batch_size"]
SEEDS = (0, 1, 2)
SAME = {name: POLICY[name] for name in ("device", "push_to_hub", "execution", "replan_interval")}
RATE = {name: POLICY[name] for name in ("optimizer_lr", "lr_schedule", "lr_warmup_steps")}
SIZE = {"dim_model": 128, "n_heads": 4, "dim_feedforward": 512}

ACT = {
    "type": "act_chunked",
    **SAME,
    **RATE,
    **SIZE,
    "chunk_size": POLICY["horizon"],
    "dropout": 0,
}
VQBET = {
    "type": "vqbet_chunked",
    **SAME,
    "optimizer_lr": POLICY["optimizer_lr"],
    "chunk_size": POLICY["horizon"],
    "gpt_hidden_dim": 128,
    "gpt_n_layer": 2,
    "gpt_n_head": 4,
    "offset_loss_weight": 1000,
}

# As wide, deep and often asked as ours, without the VAE: a step of its defaults takes many times as long.
LEROBOT = {
    "type": "act",
    "device": "cpu",
    "push_to_hub": False,
    **SIZE,
    "chunk_size": POLICY["horizon"],
    "n_action_steps": POLICY["replan_interval"],
    "use_vae": False,
    "dropout": 0,
}


def act(*, velocity: bool = False, **changes: Any) -> Variant:
    """`act_chunked` but for these settings."""
    return Variant({**ACT, **changes}, 2000, BATCH, velocity=velocity)


def lerobot(optimizer_lr: float) -> Variant:
    """LeRobot's `act`, for as many minutes, with this package's reader: its own would take most of them."""
    return Variant({**LEROBOT, "optimizer_lr": optimizer_lr}, 2000, BATCH, fast_reader=True)


VARIANTS = {
    "diffusion_chunked": Variant(POLICY, RECIPE["steps"], BATCH),
    "act_chunked": act(),
    "vqbet_chunked": Variant(VQBET, 3000, BATCH),
    "lerobot_act": lerobot(3e-4),
    "lerobot_act_slower": lerobot(1e-4),
    "lerobot_act_faster": lerobot(1e-3),
    "diffusion_velocities": Variant(POLICY, RECIPE["steps"], BATCH, velocity=True),
    "act_velocities": act(velocity=True),
    **{f"chunk_{size}": act(chunk_size=size) for size in (5, 10, 40)},
}


def policies(task: str) -> Iterator[Run]:
    """Every policy type on the same data; three training seeds of ours."""
    for variant in ("diffusion_chunked", "act_chunked", "vqbet_chunked"):
        for seed in SEEDS:
            yield Run(task, variant, seed)
    for variant in ("lerobot_act", "lerobot_act_slower", "lerobot_act_faster"):
        yield Run(task, variant)


def execution(task: str) -> Iterator[Run]:
    """Chunk length of `act_chunked` against replanning; a chunk is executed up to its end at most."""
    for variant in ("chunk_5", "chunk_10", "act_chunked", "chunk_40"):
        size = VARIANTS[variant].policy["chunk_size"]
        for interval in (1, 2, 5, 10, 20):
            if interval < size:
                yield Run(task, variant, sampling={"replan_interval": interval})
        if size <= 20:  # to its end
            yield Run(task, variant, sampling={"execution": "open_loop", "replan_interval": None})


def velocities(task: str) -> Iterator[Run]:
    """The same where velocities are observed, as the originals do."""
    for variant in ("act_velocities", "diffusion_velocities"):
        for seed in SEEDS:
            yield Run(task, variant, seed)


STUDIES = {"policies": policies, "execution": execution, "velocities": velocities}
