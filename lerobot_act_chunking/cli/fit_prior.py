"""``act-chunking latent`` and ``fit-prior``: is a policy's latent in use, and what does acting sample?"""

from pathlib import Path
from typing import Annotated

import typer

from lerobot_act_chunking.cli.options import OUT, Json, Picture
from lerobot_act_chunking.cli.progress import shown
from lerobot_act_chunking.cli.reporting import finish

Checkpoint = Annotated[
    str,
    typer.Argument(help="An act_chunked checkpoint with a latent: folder (…/pretrained_model) or repo id."),
]
Dataset = Annotated[str, typer.Argument(help="Folder of the LeRobotDataset that it was trained on.")]
MostSamples = Annotated[
    int, typer.Option("--samples", help="Chunks to encode, evenly spread over the dataset.")
]
Seed = Annotated[int, typer.Option(help="Of all that is random.")]


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
    from lerobot_act_chunking.diagnostics.latent.diagnosis import diagnose
    from lerobot_act_chunking.diagnostics.latent.plots import plot_report
    from lerobot_act_chunking.diagnostics.latent.settings import Settings
    from lerobot_act_chunking.diagnostics.latent.terminal import print_report

    settings = Settings(checkpoint, dataset, samples=samples, seed=seed)
    with shown("encoding demonstrations"):
        report = diagnose(settings)
    finish(report, print_report, plot_report, json=json, picture=out)


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
    from lerobot_act_chunking.diagnostics.latent.diagnosis import fit_prior
    from lerobot_act_chunking.diagnostics.latent.plots import plot_report
    from lerobot_act_chunking.diagnostics.latent.settings import Settings
    from lerobot_act_chunking.diagnostics.latent.terminal import print_report
    from lerobot_act_chunking.policies.saving import check_absent

    check_absent(out)
    settings = Settings(checkpoint, dataset, samples=samples, seed=seed)
    with shown("encoding demonstrations"):
        report = fit_prior(settings, component_weights, out)
    finish(report, print_report, plot_report, json=json, picture=plot, made=[f"checkpoint: {out}"])
