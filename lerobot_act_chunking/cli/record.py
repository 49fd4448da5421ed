"""``act-chunking record``: scripted demonstrations into a LeRobotDataset."""

from pathlib import Path
from typing import Annotated, Any

import typer

from lerobot_act_chunking.cli.options import Address, Executor, asked_workers


def record_command(
    repo_id: Annotated[str, typer.Option(help="Name of the dataset, user/name.")],
    root: Annotated[
        Path | None,
        typer.Option(help="Folder of the dataset. \\[default: where LeRobot looks for the repo id]"),
    ] = None,
    env: Annotated[
        str, typer.Option(help="aloha_sim, gymnasium_robotics, so_arm_sim or three_gates.")
    ] = "aloha_sim",
    task: Annotated[
        str | None,
        typer.Option(
            help="transfer_cube, insertion, transfer_modes or language_transfer; FetchReach-v4, "
            "FetchPush-v4, FetchSlide-v4 or FetchPickAndPlace-v4; pick_place, stack or two_ways "
            "(so_arm_sim); three_gates. "
            "\\[default: the first of each]"
        ),
    ] = None,
    episodes: Annotated[int, typer.Option(help="Successful episodes to record.")] = 50,
    obs: Annotated[
        str, typer.Option(help="state (robot, objects), pixels (cameras) or pixels_state (cameras, robot).")
    ] = "state",
    velocity: Annotated[
        bool | None,
        typer.Option(
            "--velocity/--no-velocity",
            help="Record velocities. \\[default: not ALOHA's; Fetch's, which belong to the original]",
        ),
    ] = None,
    cameras: Annotated[
        str,
        typer.Option(
            help="Cameras, as in top,angle,left_wrist. \\[default: top, view or front,wrist; none with "
            "--obs state]"
        ),
    ] = "",
    image_height: Annotated[int, typer.Option(help="Height of every camera's video \\[px].")] = 480,
    image_width: Annotated[int, typer.Option(help="Width of every camera's video \\[px].")] = 640,
    render_quality: Annotated[
        str, typer.Option(help="full (the original's look) or fast (no shadows and reflections; for CPUs).")
    ] = "full",
    success: Annotated[
        str | None,
        typer.Option(
            help="What counts as success. ALOHA: hold (lifted and held) or touch (gym-aloha's). Fetch: final "
            "(at the episode's last step) or any (ends there). SO-101: released (at rest there) or placed. "
            "\\[default: the first]"
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the first episode; lerobot-eval begins at 1000.")] = 0,
    operators: Annotated[
        str,
        typer.Option(
            "--operators",
            "--operator",
            help="Who demonstrates, in turn: steady, unhurried, brisk, hesitant, cautious, shaky, clumsy, "
            "remote, two_sided, programmed, stepwise, methodical; as in brisk,shaky. \\[default: the expert, "
            "with the options below]",
        ),
    ] = "",
    speed: Annotated[float, typer.Option(help="The expert's pace, 1 is nominal.")] = 1.0,
    waypoint_noise: Annotated[float, typer.Option(help="Random shift of free way-points, std \\[m].")] = 0.0,
    action_noise: Annotated[
        float,
        typer.Option(
            help="Disturbance of what is executed, std \\[rad; SO-101: degrees; Fetch: of the largest one]; "
            "recorded actions stay clean."
        ),
    ] = 0.0,
    dwell: Annotated[
        float, typer.Option(help="Pause at each grasp and release, before each push \\[s].")
    ] = 0.0,
    mode_shares: Annotated[
        str,
        typer.Option(
            help="transfer_modes, three_gates, two_ways: percentages of the episodes that go each way, "
            "as in 80,15,5. \\[default: equal]"
        ),
    ] = "",
    workers: Annotated[
        int | None,
        typer.Option(
            help="Processes that play episodes; the dataset is the same. \\[default: 1; with --executor=ray "
            "one on each CPU of the cluster]"
        ),
    ] = None,
    executor: Executor = "local",
    address: Address = None,
) -> None:
    """Record an expert's successful episodes as a LeRobotDataset.

    Can be stopped at any moment: the same command goes on from there, and the dataset appears when complete.
    """
    from lerobot_act_chunking.envs.demonstration import ExpertOptions
    from lerobot_act_chunking.recording import RecordSpec

    n_workers, cluster = asked_workers(workers, executor, address, default=1)
    _run(
        RecordSpec(
            repo_id=repo_id,
            root=root,
            env=env,
            task=task,
            episodes=episodes,
            obs=obs,
            velocity=velocity,
            cameras=_names(cameras),
            image_height=image_height,
            image_width=image_width,
            render_quality=render_quality,
            success=success,
            seed=seed,
            expert=ExpertOptions(speed, waypoint_noise, action_noise, dwell),
            operators=_names(operators),
            mode_shares=_shares(mode_shares),
            workers=n_workers,
            cluster=cluster,
        )
    )


def _names(listed: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in listed.split(",") if name.strip())


def _shares(listed: str) -> tuple[float, ...]:
    from lerobot_act_chunking.errors import ConfigurationError

    try:
        return tuple(map(float, _names(listed)))
    except ValueError:
        raise ConfigurationError(
            f"mode_shares {listed!r} are percentages with commas between them, as in 80,15,5"
        ) from None


def _run(spec: Any) -> None:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    from lerobot_act_chunking.recording import RecordingProgress, record

    console = Console()
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as bar:
        what = f"recording {spec.source().environment.task}"
        line = bar.add_task(what, total=spec.episodes)

        def show(progress: RecordingProgress) -> None:
            failed = f", {progress.failed} failed" if progress.failed else ""
            bar.update(line, completed=progress.recorded, description=what + failed)

        result = record(spec, progress=show)
        bar.update(line, completed=result.episodes)
    console.print(
        f"{'was already complete' if result.already_complete else 'recorded'}: {result.episodes} episodes, "
        f"{result.frames} frames; the expert succeeded in {result.episodes} of {result.attempts} attempts"
    )
    for mode, (discarded, attempts) in result.modes.items():
        console.print(f"mode {mode}: {discarded} of {attempts} attempts discarded", highlight=False)
    for operator, (discarded, attempts) in result.operators.items():
        console.print(f"{operator}: {discarded} of {attempts} attempts discarded", highlight=False)
    console.print(f"dataset: {result.root}", soft_wrap=True, highlight=False)
