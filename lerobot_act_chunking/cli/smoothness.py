"""``act-chunking smoothness``: how smooth a policy's or a dataset's motion is."""

from pathlib import Path
from typing import Annotated

import typer

from lerobot_act_chunking.cli.environment import Fields, Success, SuccessKey, Task, environment_to_run
from lerobot_act_chunking.cli.options import OUT, to_a_file
from lerobot_act_chunking.cli.reporting import finish


def smoothness_command(
    sources: Annotated[
        list[str],
        typer.Argument(help="Checkpoint folders or repo ids, LeRobotDataset folders; compared in one table."),
    ],
    env: Fields = None,
    task: Task = None,
    success: Success = None,
    success_key: SuccessKey = None,
    episodes: Annotated[int, typer.Option(help="Checkpoints: episodes to run.")] = 50,
    seed: Annotated[int, typer.Option(help="Checkpoints: seed of the first episode.")] = 1000,
    n_envs: Annotated[int, typer.Option(help="Checkpoints: episodes that run together.")] = 50,
    replan_interval: Annotated[
        int | None,
        typer.Option(help="Datasets: control steps between the chunks that made them. \\[default: none]"),
    ] = None,
    json_file: Annotated[
        Path | None,
        typer.Option("--json", callback=to_a_file, help="Write all numbers, also per joint."),
    ] = None,
    out: Annotated[Path | None, typer.Option(*OUT, "--plot", callback=to_a_file, help="Draw a PNG.")] = None,
) -> None:
    """Measure smoothness: jerk, spectra, jumps at chunk boundaries, chunk disagreement, tracking lag.

    All sources are measured in units of the first one's action standard deviation. Without an
    environment checkpoints run transfer_cube.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

    from lerobot_act_chunking.diagnostics.smoothness.diagnosis import diagnose
    from lerobot_act_chunking.diagnostics.smoothness.plots import plot_report
    from lerobot_act_chunking.diagnostics.smoothness.settings import EvaluationSpec, Settings
    from lerobot_act_chunking.diagnostics.smoothness.terminal import print_report

    environment = environment_to_run(env, task, success, success_key=success_key)
    spec = EvaluationSpec(environment, episodes=episodes, seed=seed, n_envs=n_envs)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console()) as bar:
        lines: dict[str, TaskID] = {}

        def show(name: str, finished: int) -> None:
            if name not in lines:
                lines[name] = bar.add_task(f"running {name}", total=episodes)
            bar.update(lines[name], completed=finished)

        report = diagnose(Settings(tuple(sources), spec, replan_interval), show)
    finish(report, print_report, plot_report, json=json_file, picture=out)
