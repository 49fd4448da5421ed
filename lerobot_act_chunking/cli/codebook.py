"""``act-chunking codebook``: what do a tokenizer's codes do, and which tokenizer suits a dataset?"""

from contextlib import nullcontext
from typing import Annotated

import typer

from lerobot_act_chunking.cli.options import Json, Picture
from lerobot_act_chunking.cli.progress import shown
from lerobot_act_chunking.cli.reporting import finish


def codebook_command(
    source: Annotated[
        str,
        typer.Argument(
            help="A vqbet_chunked checkpoint or a file of train-tokenizer: what its codes do. "
            "A LeRobotDataset's folder: which tokenizer suits it.",
            metavar="CHECKPOINT|FILE|DATASET",
        ),
    ],
    dataset: Annotated[
        str | None,
        typer.Option(help="Folder of another LeRobotDataset: do the codes still fit? (CHECKPOINT, FILE)"),
    ] = None,
    max_lost: Annotated[
        float, typer.Option(help="Share of the actions' variance that codes may lose.")
    ] = 0.1,
    chunk_size: Annotated[
        int | None,
        typer.Option(help="Actions per chunk, as of the policy. (DATASET)", show_default="policy's"),
    ] = None,
    chunk_stride: Annotated[
        int | None, typer.Option(help="Control steps between them. (DATASET)", show_default="policy's")
    ] = None,
    steps: Annotated[int, typer.Option(help="Training steps for those that learn. (DATASET)")] = 1000,
    seed: Annotated[int, typer.Option(help="Of all that is random.")] = 0,
    json: Json = None,
    out: Picture = None,
) -> None:
    """What a tokenizer's codes are used for and what they lose; or which tokenizer suits a dataset.

    Only actions are read, never images. Exit status: 0 fine or to be looked at, 11 failed, 10 cannot be
    judged.
    """
    from rich.progress import track

    from lerobot_act_chunking.diagnostics.codebook import plots, terminal
    from lerobot_act_chunking.diagnostics.codebook.comparison import plots as comparison_plots
    from lerobot_act_chunking.diagnostics.codebook.comparison import terminal as comparison_terminal
    from lerobot_act_chunking.diagnostics.codebook.comparison.report import ComparisonReport
    from lerobot_act_chunking.diagnostics.codebook.diagnosis import diagnose
    from lerobot_act_chunking.diagnostics.codebook.settings import Settings, Thresholds

    settings = Settings(
        source=source,
        dataset=dataset,
        chunk_size=chunk_size,
        chunk_stride=chunk_stride,
        steps=steps,
        seed=seed,
        thresholds=Thresholds.with_max_lost(max_lost),
    )
    with nullcontext() if settings.compares else shown("coding demonstrations"):
        report = diagnose(settings, lambda candidates: track(candidates, "fitting", transient=True))
    if isinstance(report, ComparisonReport):
        finish(report, comparison_terminal.print_report, comparison_plots.plot_report, json=json, picture=out)
    finish(report, terminal.print_report, plots.plot_report, json=json, picture=out)
