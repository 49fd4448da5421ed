"""``act-chunking codebook``: what do a tokenizer's codes do, and which tokenizer suits a dataset?"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from lerobot_act_chunking.cli.options import Picture
from lerobot_act_chunking.cli.progress import shown

if TYPE_CHECKING:
    from lerobot_act_chunking.diagnostics.codebook.verdict import Thresholds


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
    json: Annotated[Path | None, typer.Option(help="Write every number to this file.")] = None,
    out: Picture = None,
) -> None:
    """What a tokenizer's codes are used for and what they lose; or which tokenizer suits a dataset.

    Only actions are read, never images. Exit status: 0 fine or to be looked at, 11 failed, 10 cannot be
    judged.
    """
    from lerobot_act_chunking.data.actions import is_dataset
    from lerobot_act_chunking.diagnostics.codebook.verdict import Thresholds

    console = Console()
    thresholds = Thresholds.losing(max_lost)
    sizes = {"chunk_size": chunk_size, "chunk_stride": chunk_stride}
    if is_dataset(source):
        _refuse({"dataset": dataset}, "a checkpoint or a tokenizer file, and this is a dataset")
        found = _compare(source, sizes, thresholds, steps, seed, console)
    else:
        _refuse(sizes, "a dataset; these codes are for chunks of their own")
        found = _diagnose(source, dataset, thresholds, seed)
    written = found.write(json, out)  # before printing, which a closed pipe may end
    found.show(found.report, console)
    for line in written:
        console.print(line, soft_wrap=True)
    raise typer.Exit(found.report.exit_code)


@dataclass(frozen=True)
class _Found:
    """A report, with how it is shown and drawn."""

    report: Any
    show: Callable[[Any, Console], None]
    draw: Callable[[Any, Path], Path]

    def write(self, json: Path | None, out: Path | None) -> list[str]:
        written = []
        if json is not None:
            written.append(f"numbers: {self.report.write_json(json)}")
        if out is not None:
            written.append(f"picture: {self.draw(self.report, out)}")
        return written


def _refuse(options: dict[str, Any], goes_with: str) -> None:
    from lerobot_act_chunking.errors import ConfigurationError

    for name, value in options.items():
        if value is not None:
            raise ConfigurationError(f"--{name.replace('_', '-')}={value} goes with {goes_with}")


def _diagnose(source: str, dataset: str | None, thresholds: "Thresholds", seed: int) -> _Found:
    from lerobot_act_chunking.diagnostics.codebook.card import print_card
    from lerobot_act_chunking.diagnostics.codebook.plots import plot_report
    from lerobot_act_chunking.diagnostics.codebook.report import diagnose
    from lerobot_act_chunking.diagnostics.codebook.subject import find_data, load_subject

    with shown("coding demonstrations"):
        subject = load_subject(source)
        report = diagnose(subject, *find_data(subject, dataset), thresholds, seed=seed)
    return _Found(report, print_card, plot_report)


def _compare(
    folder: str, sizes: dict[str, Any], thresholds: "Thresholds", steps: int, seed: int, console: Console
) -> _Found:
    from rich.progress import track

    from lerobot_act_chunking.data.timing import ChunkTiming
    from lerobot_act_chunking.diagnostics.codebook.comparison_card import print_comparison
    from lerobot_act_chunking.diagnostics.codebook.comparison_plot import plot_comparison
    from lerobot_act_chunking.diagnostics.codebook.fitting import compare
    from lerobot_act_chunking.diagnostics.core.episodes import read_episodes
    from lerobot_act_chunking.policies.vqbet_chunked.presets import preset_values

    usual = preset_values("base", tokenizer=None, pretrained=False)
    chosen = {name: usual[name] if value is None else value for name, value in sizes.items()}

    report = compare(
        read_episodes(folder),
        ChunkTiming(1, **chosen),
        thresholds,
        steps=steps,
        seed=seed,
        watch=lambda candidates: track(candidates, "fitting", console=console, transient=True),
    )
    return _Found(report, print_comparison, plot_comparison)
