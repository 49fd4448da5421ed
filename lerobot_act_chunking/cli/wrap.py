"""``act-chunking wrap``: another execution for any checkpoint, as a checkpoint of its own."""

from pathlib import Path
from typing import Annotated, Any

import typer

from lerobot_act_chunking.cli.options import OUT, whole_numbers


def wrap_command(
    path: Annotated[str, typer.Argument(help="Checkpoint folder (…/pretrained_model) or repo id.")],
    out: Annotated[Path, typer.Option(*OUT, help="The folder to write; must not exist.")],
    execution: Annotated[
        str, typer.Option(help="open_loop, receding, ensemble, crossfade, adaptive or coherence.")
    ] = "ensemble",
    replan_interval: Annotated[
        int | None, typer.Option(help="Control steps between two chunks. \\[default: a quarter of a chunk]")
    ] = None,
    n_action_steps: Annotated[
        int | None, typer.Option(help="How many of a chunk's first actions may be used. \\[default: all]")
    ] = None,
    latency_steps: Annotated[
        int, typer.Option(help="Control steps that pass before a chunk can be used.")
    ] = 0,
    coeff: Annotated[
        float | None,
        typer.Option(
            help="Ensemble, adaptive: how fast weights change with age \\[1/step]. \\[default: 0.01]"
        ),
    ] = None,
    weighting: Annotated[
        str | None,
        typer.Option(
            help="Ensemble, adaptive: act (old chunks weigh more), recency or uniform. \\[default: act]"
        ),
    ] = None,
    crossfade_steps: Annotated[
        int | None, typer.Option(help="Crossfade: length of the blend \\[control steps].")
    ] = None,
    adaptive_kernel: Annotated[
        str | None, typer.Option(help="Adaptive: cosine, gaussian or gate. \\[default: gate]")
    ] = None,
    adaptive_scale: Annotated[float | None, typer.Option(help="Adaptive: scale of the kernel.")] = None,
    n_samples: Annotated[int | None, typer.Option(help="Coherence: chunks to choose from.")] = None,
    smoothing_steps: Annotated[
        int | None,
        typer.Option(help="Moving mean over each chunk \\[control steps], an odd number. \\[default: none]"),
    ] = None,
    gripper_dims: Annotated[
        str, typer.Option(help="Action dimensions that are never averaged, blended or smoothed, as in 6,13.")
    ] = "",
) -> None:
    """Wrap a checkpoint of any policy type so that its chunks are executed in another way.

    The new checkpoint holds the policy and its processors; LeRobot's commands load it like any other.
    """
    _run(
        path,
        out,
        execution=execution,
        replan_interval=replan_interval,
        n_action_steps=n_action_steps,
        latency_steps=latency_steps,
        temporal_ensemble_coeff=coeff,
        ensemble_weighting=weighting,
        crossfade_steps=crossfade_steps,
        adaptive_kernel=adaptive_kernel,
        adaptive_scale=adaptive_scale,
        n_samples=n_samples,
        smoothing_steps=smoothing_steps,
        gripper_dims=_dimensions(gripper_dims),
    )


def _dimensions(text: str) -> list[int]:
    refusal = typer.BadParameter(f"{text!r} is not a list of dimensions such as 6,13")
    return list(whole_numbers(text, refusal, gaps=True))


def _run(path: str, out: Path, **execution: Any) -> None:
    from rich.console import Console

    from lerobot_act_chunking.policies.saving import check_absent, save_checkpoint
    from lerobot_act_chunking.policies.temporal_ensemble.wrapping import load_wrapped

    check_absent(out)
    wrapped = load_wrapped(path, **execution)
    save_checkpoint(wrapped, out)
    config, console = wrapped.policy.config, Console()
    settings = config.execution_settings
    console.print(
        f"wrapped: {config.inner_config.type}, chunks of {settings.chunk_size} control steps; "
        f"execution={settings.execution}, a new chunk every {settings.replan_interval} steps",
        soft_wrap=True,
        highlight=False,
    )
    console.print(f"checkpoint: {out}", soft_wrap=True, highlight=False)
    console.print(
        f"evaluate it: lerobot-eval --policy.path={out} --env.type=<type>", soft_wrap=True, highlight=False
    )
