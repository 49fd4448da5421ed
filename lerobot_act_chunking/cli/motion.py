"""``act-chunking motion``: run one episode of a checkpoint and draw it."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from lerobot_act_chunking.cli.environment import Fields, Success, SuccessKey, Task, environment_to_run
from lerobot_act_chunking.cli.options import OUT, to_a_file
from lerobot_act_chunking.cli.progress import shown


def motion_command(
    policy_path: Annotated[str, typer.Argument(help="Checkpoint folder (…/pretrained_model) or repo id.")],
    env: Fields = None,
    task: Task = None,
    success: Success = None,
    success_key: SuccessKey = None,
    seed: Annotated[int, typer.Option(help="Seed of the episode.")] = 1000,
    out: Annotated[Path, typer.Option(*OUT, callback=to_a_file, help="The PNG to write.")] = Path(
        "motion.png"
    ),
) -> None:
    """Run one episode of a checkpoint and draw frames, actions, grippers and reward.

    Without an environment it runs transfer_cube.
    """
    from lerobot_act_chunking.diagnostics.motion import plot_motion, record_motion

    environment = environment_to_run(env, task, success, success_key=success_key)
    with shown(f"running {environment.name}") as progress:
        motion = record_motion(policy_path, environment, seed=seed, progress=progress)
    for word, sentence in (("untrained", motion.untrained), ("success unknown", motion.never_said)):
        if sentence is not None:
            Console().print(f"[yellow]{word}:[/] {escape(sentence)}", highlight=False, soft_wrap=True)
    Console().print(f"{motion.title} after {len(motion.commands) * motion.dt:.1f} s")
    Console().print(f"picture: {plot_motion(motion, out)}", soft_wrap=True)
