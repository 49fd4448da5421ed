"""``act-chunking lm-ablation``: does a language model's start help a policy, and which part of it?"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from lerobot_act_chunking.cli.environment import (
    EnvironmentCommand,
    Fields,
    Success,
    SuccessKey,
    Task,
    asked_environment,
    gathered,
)
from lerobot_act_chunking.cli.options import Json, Picture, parse_numbers, to_a_folder
from lerobot_act_chunking.cli.reporting import finish
from lerobot_act_chunking.cli.serve import PolicyCommand


class TrainingCommand(PolicyCommand):
    """A command with ``--env.FIELD`` and ``--policy.FIELD``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """As of every command, with each of them as a value of the option that is declared."""
        return super().parse_args(ctx, list(gathered(ctx, args, EnvironmentCommand.prefix)))


def lm_ablation_command(
    dataset: Annotated[str, typer.Argument(help="Folder of a LeRobotDataset, with a task for each episode.")],
    env: Fields = None,
    task: Task = None,
    success: Success = None,
    success_key: SuccessKey = None,
    policy: Annotated[
        list[str] | None,
        typer.Option(
            "--policy.FIELD", metavar="VALUE", help="Any setting of act_chunked: --policy.optimizer_lr=1e-4."
        ),
    ] = None,
    shift: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FIELD=VALUE",
            help="Let policies act in a changed environment, too, as with other words; may be repeated.",
        ),
    ] = None,
    cells: Annotated[
        str | None,
        typer.Option(help="What is trained: T-R,T-LM',M-R,M-LM' is the two by two. \\[default: all]"),
    ] = None,
    sizes: Annotated[str, typer.Option(help="Numbers of demonstrations.")] = "5,10,25,50",
    seeds: Annotated[str, typer.Option(help="Seeds of the trainings.")] = "0,1,2,3,4",
    steps: Annotated[int, typer.Option(help="Of each training.")] = 1500,
    batch_size: Annotated[int, typer.Option(help="Of each step.")] = 16,
    looks: Annotated[int, typer.Option(help="How often the validation loss is measured.")] = 10,
    episodes: Annotated[int, typer.Option(help="Of each policy, in each environment.")] = 100,
    seed: Annotated[int, typer.Option(help="Of the first episode.")] = 1000,
    held_out: Annotated[int, typer.Option(help="The last demonstrations, for the validation loss.")] = 10,
    pretraining_steps: Annotated[int, typer.Option(help="Of each encoder that is pretrained here.")] = 2000,
    text_tokens: Annotated[int, typer.Option(help="Word pieces of the longest instruction.")] = 16,
    language_model: Annotated[
        str | None,
        typer.Option(help="Folder of a BERT-like model. \\[default: MiniLM, of the extra language]"),
    ] = None,
    output_dir: Annotated[
        Path, typer.Option(callback=to_a_folder, help="Where every training is written down.")
    ] = Path("outputs/lm_ablation"),
    json: Json = None,
    out: Picture = None,
) -> None:
    """Compare a language model's weights with random ones as the start of act_chunked's encoder.

    Two architectures of one size, several starts, training seeds and numbers of demonstrations. Stop it
    whenever you like: the same command goes on where it was. Exit status: 0 pretraining helps or harms,
    10 it is not told apart from a random start, 11 the architectures are not of one size.
    """
    from lerobot_act_chunking.cli.progress import named
    from lerobot_act_chunking.diagnostics.lm_ablation.cells import CELLS
    from lerobot_act_chunking.diagnostics.lm_ablation.diagnosis import diagnose
    from lerobot_act_chunking.diagnostics.lm_ablation.page import write_page
    from lerobot_act_chunking.diagnostics.lm_ablation.plots import plot_report
    from lerobot_act_chunking.diagnostics.lm_ablation.settings import Budget, Settings, parse_names
    from lerobot_act_chunking.diagnostics.lm_ablation.terminal import print_report
    from lerobot_act_chunking.errors import ConfigurationError

    environment = asked_environment(env, task, success, success_key=success_key)
    if environment is None:
        raise ConfigurationError(
            "lm-ablation lets policies act: give --env.type (of LeRobot or a plug-in), or --task (as "
            "insertion)"
        )
    settings = Settings(
        dataset=dataset,
        environment=environment,
        output_dir=output_dir,
        shifts=tuple(shift or ()),
        cells=parse_names(cells, tuple(CELLS)),
        seeds=parse_numbers("--seeds", seeds),
        sizes=parse_numbers("--sizes", sizes),
        held_out=held_out,
        language_model=language_model,
        text_tokens=text_tokens,
        policy=_fields(policy or ()),
        budget=Budget(steps, batch_size, looks, episodes, pretraining_steps),
        seed=seed,
    )
    with named("reading") as progress:
        report = diagnose(settings, progress)
    picture = plot_report(report, output_dir / "report.png")
    made = [f"report: {write_page(report, picture)}", f"numbers: {report.write(output_dir / 'report.json')}"]
    finish(report, print_report, plot_report, json=json, picture=out, made=made)


def _fields(given: Sequence[str]) -> dict[str, Any]:
    """Settings of the policy by their names, as YAML reads them."""
    import yaml

    return {name: yaml.safe_load(value) for name, _, value in (each.partition("=") for each in given)}
