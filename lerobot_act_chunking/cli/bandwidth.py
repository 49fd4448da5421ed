"""``act-chunking bandwidth``: how fast can a policy react that executes overlapping chunks?"""

from contextlib import nullcontext
from typing import Annotated

import typer

from lerobot_act_chunking.cli.options import Json, Picture
from lerobot_act_chunking.cli.progress import shown
from lerobot_act_chunking.cli.reporting import finish


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
    json: Json = None,
    out: Picture = None,
) -> None:
    """How fast the executed command follows what the plan did not foresee, in closed form and measured.

    Exit status: 0 within the limits given (or none given), 11 beyond them, 10 cannot be judged.
    """
    from lerobot_act_chunking.diagnostics.bandwidth.diagnosis import diagnose
    from lerobot_act_chunking.diagnostics.bandwidth.plots import plot_report
    from lerobot_act_chunking.diagnostics.bandwidth.settings import Limits, Push, Settings
    from lerobot_act_chunking.diagnostics.bandwidth.terminal import print_report

    push = None if env is None else Push(env, push_m, push_step, episodes, seed)
    settings = Settings(
        checkpoint=checkpoint,
        execution={
            "chunk_size": chunk_size,
            "n_action_steps": n_action_steps,
            "execution": execution,
            "replan_interval": replan_interval,
            "latency_steps": latency_steps,
            "ensemble_weighting": weighting,
            "temporal_ensemble_coeff": coeff,
            "crossfade_steps": crossfade_steps,
        },
        limits=Limits(disturbance_hz, max_settle_s, loop_gain),
        fps=fps,
        push=push,
    )
    with nullcontext() if push is None else shown("pushing") as progress:
        report = diagnose(settings, progress)
    finish(report, print_report, plot_report, json=json, picture=out)
