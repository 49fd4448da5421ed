"""``act-chunking steps``: are a diffusion policy's denoising steps enough, and would more help?"""

from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from lerobot_act_chunking.cli.environment import Fields, SuccessKey, asked_environment
from lerobot_act_chunking.cli.options import Json, Picture, parse_numbers
from lerobot_act_chunking.cli.reporting import finish

if TYPE_CHECKING:
    from lerobot_act_chunking.diagnostics.steps.report import StepsReport
    from lerobot_act_chunking.diagnostics.steps.settings import Settings


def steps_command(
    checkpoint: Annotated[str, typer.Argument(help="A diffusion_chunked checkpoint (flow or ddpm).")],
    dataset: Annotated[
        str | None,
        typer.Option(help="Folder of a LeRobotDataset; default: the one the checkpoint was trained on."),
    ] = None,
    episodes: Annotated[int, typer.Option(help="Episodes to take, from the last one backwards.")] = 10,
    observations: Annotated[int, typer.Option(help="Observations to take from them.")] = 256,
    tolerance: Annotated[
        float | None,
        typer.Option(help="Difference that does not matter: mm for ALOHA, else raw units; default: 0.5 mm."),
    ] = None,
    sampler: Annotated[
        list[str] | None, typer.Option(help="Sampler to sweep, may be repeated; default: all of its kind.")
    ] = None,
    steps: Annotated[
        str | None, typer.Option(help="Step counts, such as 2,5,10; default: eleven from 1 to 100.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the noise.")] = 0,
    success: Annotated[
        str | None,
        typer.Option(
            help="Also run this task by number of steps, as FetchPush-v4; short for --env.type=... "
            "--env.task=NAME."
        ),
    ] = None,
    env: Fields = None,
    success_key: SuccessKey = None,
    success_seeds: Annotated[int, typer.Option(min=1, help="Episodes per number of steps.")] = 50,
    json: Json = None,
    out: Picture = None,
) -> None:
    """How far few denoising steps are from many, in millimetres, and whether the model is the limit instead.

    Exit status: 0 the policy's steps are enough, 11 they or the model are not, 10 cannot be judged.
    """
    from lerobot_act_chunking.diagnostics.steps.plots import plot_report
    from lerobot_act_chunking.diagnostics.steps.settings import Settings
    from lerobot_act_chunking.diagnostics.steps.terminal import print_report

    settings = Settings(
        checkpoint=checkpoint,
        dataset=dataset,
        episodes=episodes,
        observations=observations,
        tolerance=tolerance,
        samplers=tuple(sampler or ()),
        steps=parse_numbers("steps", steps or None),
        seed=seed,
        environment=asked_environment(env, success, success_key=success_key, short="--success"),
        success_seeds=success_seeds,
    )
    finish(_diagnose(settings), print_report, plot_report, json=json, picture=out)


def _diagnose(settings: "Settings") -> "StepsReport":
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    from lerobot_act_chunking.diagnostics.steps.diagnosis import diagnose

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console()) as bar:
        reading = bar.add_task("reading the checkpoint and its observations", total=None)
        sampling = _show_on(bar, "sampling")

        def show(done: int, planned: int) -> None:
            bar.update(reading, visible=False)
            sampling(done, planned)

        where = "" if settings.environment is None else settings.environment.name
        return diagnose(settings, show, _show_on(bar, f"running {where}"))


def _show_on(bar: Any, description: str) -> Any:
    lines: list[Any] = []

    def show(done: int, planned: int) -> None:
        if not lines:
            lines.append(bar.add_task(description, total=planned))
        bar.update(lines[0], completed=done)

    return show
