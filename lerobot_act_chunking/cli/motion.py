"""``act-chunking motion``: run one episode of a checkpoint and draw it."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console


def motion_command(
    policy_path: Annotated[str, typer.Argument(help="Checkpoint folder (…/pretrained_model) or repo id.")],
    task: Annotated[str, typer.Option(help="transfer_cube or insertion.")] = "transfer_cube",
    seed: Annotated[int, typer.Option(help="Seed of the object's pose.")] = 1000,
    success: Annotated[str, typer.Option(help="Rule that ends the episode: touch or hold.")] = "touch",
    out: Annotated[Path, typer.Option(help="The PNG to write.")] = Path("motion.png"),
) -> None:
    """Run one episode of a checkpoint in aloha_sim and draw frames, joints, grippers and reward."""
    from lerobot_act_chunking.diagnostics.motion import plot_motion, record_motion

    motion = record_motion(policy_path, task=task, seed=seed, success=success)
    Console().print(f"{motion.title} after {len(motion.commands) * motion.dt:.1f} s")
    Console().print(f"picture: {plot_motion(motion, out)}", soft_wrap=True)
