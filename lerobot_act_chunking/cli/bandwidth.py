"""``act-chunking bandwidth``: how fast can a policy react that executes overlapping chunks?"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from lerobot_act_chunking.cli.options import Picture
from lerobot_act_chunking.cli.progress import shown

if TYPE_CHECKING:
    from lerobot_act_chunking.diagnostics.bandwidth.push import PushStudy
    from lerobot_act_chunking.diagnostics.bandwidth.source import Source

DEFAULT_FPS = 50.0


def bandwidth_command(
    checkpoint: Annotated[
        str | None,
        typer.Argument(help="Checkpoint whose execution to analyse; options win over it; default: ACT's."),
    ] = None,
    chunk_size: Annotated[int | None, typer.Option(help="K: control steps per chunk; default: 100.")] = None,
    replan_interval: Annotated[
        int | None, typer.Option(help="R: control steps between inferences; default: 1.")
    ] = None,
    weighting: Annotated[
        str | None,
        typer.Option(help="act (old chunks weigh most), recency or uniform; default: act."),
    ] = None,
    coeff: Annotated[
        float | None, typer.Option(help="m: how fast weights change with age per step; default: 0.01.")
    ] = None,
    latency_steps: Annotated[
        int | None, typer.Option(help="d: control steps that an inference takes; default: 0.")
    ] = None,
    n_action_steps: Annotated[
        int | None, typer.Option(help="Actions of each chunk that are used; default: all.")
    ] = None,
    execution: Annotated[
        str | None,
        typer.Option(
            help="open_loop, receding, ensemble, crossfade, adaptive, coherence; default: ensemble."
        ),
    ] = None,
    crossfade_steps: Annotated[int | None, typer.Option(help="Length of a cross-fade.")] = None,
    fps: Annotated[
        float | None,
        typer.Option(help="Control steps per second; default: those of the checkpoint's training, else 50."),
    ] = None,
    disturbance_hz: Annotated[
        float | None, typer.Option(help="Limit: disturbances up to here must be followed, in Hz.")
    ] = None,
    max_settle_s: Annotated[
        float | None, typer.Option(help="Limit: 90 % of a correction within this time, in s.")
    ] = None,
    loop_gain: Annotated[
        float | None, typer.Option(help="Limit: share of an error that one step's command removes.")
    ] = None,
    env: Annotated[
        str | None,
        typer.Option(help="transfer_cube or insertion: push the object in simulation. Needs a checkpoint."),
    ] = None,
    push_m: Annotated[float, typer.Option(help="Length of the push along x, in m.")] = 0.03,
    push_step: Annotated[int, typer.Option(help="Control step of the push.")] = 40,
    episodes: Annotated[int, typer.Option(help="Episodes with and without a push.")] = 10,
    seed: Annotated[int, typer.Option(help="Seed of the first episode.")] = 1000,
    json: Annotated[Path | None, typer.Option(help="Write every number to this file.")] = None,
    out: Picture = None,
) -> None:
    """How fast the executed command follows what the plan did not foresee, in closed form and measured.

    Exit status: 0 within the limits given (or none given), 11 beyond them, 10 cannot be judged.
    """
    from lerobot_act_chunking.diagnostics.bandwidth.advice import Limits
    from lerobot_act_chunking.diagnostics.bandwidth.card import print_card
    from lerobot_act_chunking.diagnostics.bandwidth.report import analyse
    from lerobot_act_chunking.diagnostics.bandwidth.source import read_source

    limits = Limits(disturbance_hz, max_settle_s, loop_gain)
    source = read_source(
        checkpoint,
        {
            "chunk_size": chunk_size,
            "n_action_steps": n_action_steps,
            "execution": execution,
            "replan_interval": replan_interval,
            "latency_steps": latency_steps,
            "ensemble_weighting": weighting,
            "temporal_ensemble_coeff": coeff,
            "crossfade_steps": crossfade_steps,
        },
    )
    push = None
    if env is not None:
        push = _push(source, task=env, push_m=push_m, push_step=push_step, episodes=episodes, seed=seed)
        fps = push.fps if fps is None else fps
    if fps is None:
        fps = source.fps or DEFAULT_FPS
    report = analyse(source, fps, limits, push)
    console = Console()
    written = _write(report, json, out)  # before printing, which a closed pipe may end
    print_card(report, console)
    for line in written:
        console.print(line, soft_wrap=True)
    raise typer.Exit(report.exit_code)


def _write(report: Any, json: Path | None, out: Path | None) -> list[str]:
    written = []
    if json is not None:
        written.append(f"numbers: {report.write_json(json)}")
    if out is None:
        return written
    if report.push is None:
        from lerobot_act_chunking.diagnostics.bandwidth.plots import plot_report

        plot_report(report, out)
    else:
        from lerobot_act_chunking.diagnostics.bandwidth.push_plot import plot_push

        plot_push(report.push, out)
    return [*written, f"picture: {out}"]


def _push(source: "Source", **options: Any) -> "PushStudy":
    from lerobot_act_chunking.diagnostics.bandwidth.push import study_push

    with shown("pushing") as progress:
        return study_push(source, **options, progress=progress)
