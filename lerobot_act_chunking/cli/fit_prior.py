"""``act-chunking latent`` and ``fit-prior``: is a policy's latent in use, and what does acting sample?"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lerobot_act_chunking.cli.options import OUT, Picture
from lerobot_act_chunking.cli.progress import shown

if TYPE_CHECKING:
    from lerobot_act_chunking.diagnostics.latent.report import LatentReport
    from lerobot_act_chunking.diagnostics.latent.samples import Samples
    from lerobot_act_chunking.diagnostics.latent.subject import Subject

Checkpoint = Annotated[
    str,
    typer.Argument(help="An act_chunked checkpoint with a latent: folder (…/pretrained_model) or repo id."),
]
Dataset = Annotated[str, typer.Argument(help="Folder of the LeRobotDataset that it was trained on.")]
MostSamples = Annotated[
    int, typer.Option("--samples", help="Chunks to encode, evenly spread over the dataset.")
]
Seed = Annotated[int, typer.Option(help="Of all that is random.")]
Json = Annotated[Path | None, typer.Option(help="Write every number to this file.")]


def latent_command(
    checkpoint: Checkpoint,
    dataset: Dataset,
    samples: MostSamples = 4000,
    seed: Seed = 0,
    json: Json = None,
    out: Picture = None,
) -> None:
    """Posterior collapse, prior hole, or healthy? What the latent of a policy says, and what acting samples.

    Exit status: 0 healthy or to be looked at, 11 failed: acting samples what was not demonstrated.
    """
    from lerobot_act_chunking.diagnostics.latent.report import diagnose
    from lerobot_act_chunking.diagnostics.latent.verdict import Thresholds

    with shown("encoding demonstrations"):
        subject, read = _read(checkpoint, dataset, samples)
        report = diagnose(subject, read, Thresholds(), seed=seed)
    _show(report, json, out, [])
    raise typer.Exit(report.exit_code)


def fit_prior_command(
    checkpoint: Checkpoint,
    dataset: Dataset,
    out: Annotated[Path, typer.Option(*OUT, help="Checkpoint folder to write; must not exist.")],
    component_weights: Annotated[
        str, typer.Option(help="empirical: styles as often as demonstrated; uniform: all equally often.")
    ] = "empirical",
    samples: MostSamples = 4000,
    seed: Seed = 0,
    json: Json = None,
    plot: Annotated[Path | None, typer.Option(help="Draw a PNG.")] = None,
) -> None:
    """Fit the prior of a gaussian latent to the demonstrations, without training, and act by sampling it.

    The new checkpoint has the same weights; the given one is not touched. Exit status: 0 the fitted density
    samples what was demonstrated, 11 it does not.
    """
    from lerobot_act_chunking.diagnostics.latent.report import diagnose
    from lerobot_act_chunking.diagnostics.latent.saving import sample_when_acting, save_with_density
    from lerobot_act_chunking.diagnostics.latent.verdict import Thresholds
    from lerobot_act_chunking.policies.saving import check_absent

    check_absent(out)
    with shown("encoding demonstrations"):
        subject, read = _read(checkpoint, dataset, samples)
        sample_when_acting(subject, component_weights)
        report = diagnose(subject, read, Thresholds(), refit=True, seed=seed)
    assert report.density is not None  # noqa: S101  (only codes have none, and those have been refused)
    save_with_density(subject, report.density, out)
    _show(report, json, plot, [f"checkpoint: {out}"])
    raise typer.Exit(report.exit_code)


def _read(checkpoint: str, dataset: str, samples: int) -> "tuple[Subject, Samples]":
    from lerobot_act_chunking.diagnostics.latent.samples import read_samples
    from lerobot_act_chunking.diagnostics.latent.subject import load_subject
    from lerobot_act_chunking.errors import ConfigurationError

    if samples < 2:
        raise ConfigurationError(f"samples={samples} must be at least 2")
    subject = load_subject(checkpoint)
    return subject, read_samples(dataset, subject.config, samples)


def _show(report: "LatentReport", json: Path | None, picture: Path | None, written: list[str]) -> None:
    """Files before the terminal, which a closed pipe may end."""
    from rich.console import Console

    from lerobot_act_chunking.diagnostics.latent.card import print_card
    from lerobot_act_chunking.diagnostics.latent.plots import plot_report

    if json is not None:
        written.append(f"numbers: {report.write_json(json)}")
    if picture is not None:
        written.append(f"picture: {plot_report(report, picture)}")
    console = Console()
    print_card(report, console)
    for line in written:
        console.print(line, soft_wrap=True)
