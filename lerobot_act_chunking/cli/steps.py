"""``act-chunking steps``: are a diffusion policy's denoising steps enough, and would more help?"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from lerobot_act_chunking.cli.options import Picture

if TYPE_CHECKING:
    from lerobot_act_chunking.diagnostics.steps.report import Request, StepsReport


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
        typer.Option(help="Also run this task by number of steps, as FetchPush-v4."),
    ] = None,
    success_seeds: Annotated[int, typer.Option(min=1, help="Episodes per number of steps.")] = 50,
    json: Annotated[Path | None, typer.Option(help="Write every number to this file.")] = None,
    out: Picture = None,
) -> None:
    """How far few denoising steps are from many, in millimetres, and whether the model is the limit instead.

    Exit status: 0 the policy's steps are enough, 11 they or the model are not, 10 cannot be judged.
    """
    from lerobot_act_chunking.diagnostics.steps.card import print_card
    from lerobot_act_chunking.diagnostics.steps.report import Request

    request = Request(
        checkpoint=checkpoint,
        dataset=dataset,
        episodes=episodes,
        observations=observations,
        tolerance=tolerance,
        samplers=tuple(sampler or ()),
        steps=_counts(steps),
        seed=seed,
    )
    console = Console()
    report = _measure(request, success, success_seeds, console)
    written = _write(report, json, out)  # before printing, which a closed pipe may end
    print_card(report, console)
    for line in written:
        console.print(line, soft_wrap=True)
    raise typer.Exit(report.exit_code)


def _counts(text: str | None) -> tuple[int, ...]:
    from lerobot_act_chunking.errors import ConfigurationError

    try:
        return tuple(int(part) for part in text.split(",")) if text else ()
    except ValueError:
        raise ConfigurationError(f"steps={text!r} must be numbers with commas between them: 2,5,10") from None


def _measure(request: "Request", task: str | None, n_seeds: int, console: Console) -> "StepsReport":
    from dataclasses import replace

    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    from lerobot_act_chunking.diagnostics.core.environments import check_task
    from lerobot_act_chunking.diagnostics.steps.report import diagnose
    from lerobot_act_chunking.diagnostics.steps.success import cells_to_run, success_by_steps

    if task is not None:
        check_task(task)
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as bar:
        reading = bar.add_task("reading the checkpoint and its observations", total=None)
        sampling = _show_on(bar, "sampling")

        def show(done: int, planned: int) -> None:
            bar.update(reading, visible=False)
            sampling(done, planned)

        report = diagnose(request, show)
        if task is None:
            return report
        cells = cells_to_run(report.own, [result.cell for result in report.sweep.cells])
        found = success_by_steps(
            request.checkpoint,
            cells,
            task=task,
            seeds=range(1000, 1000 + n_seeds),
            progress=_show_on(bar, f"running {task}"),
        )
    return replace(report, success=found)


def _show_on(bar: Any, description: str) -> Any:
    lines: list[Any] = []

    def show(done: int, planned: int) -> None:
        if not lines:
            lines.append(bar.add_task(description, total=planned))
        bar.update(lines[0], completed=done)

    return show


def _write(report: Any, json: Path | None, out: Path | None) -> list[str]:
    from lerobot_act_chunking.diagnostics.steps.plots import plot_report

    written = []
    if json is not None:
        written.append(f"numbers: {report.write_json(json)}")
    if out is not None:
        written.append(f"picture: {plot_report(report, out)}")
    return written
