"""``act-chunking train-tokenizer``: codes for a vqbet_chunked policy, from actions alone."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from lerobot_act_chunking.cli.options import OUT, parse_numbers

if TYPE_CHECKING:
    from lerobot_act_chunking.policies.vqbet_chunked.action_chunks import ActionChunks
    from lerobot_act_chunking.policies.vqbet_chunked.tokenizer_file import TokenizerInfo
    from lerobot_act_chunking.policies.vqbet_chunked.tokenizer_training import Trained


def _option(text: str) -> Any:
    return typer.Option(help=text, show_default=False, rich_help_panel="Fields of the policy")


def train_tokenizer_command(
    dataset: Annotated[Path, typer.Argument(help="Folder of a LeRobotDataset.")],
    out: Annotated[Path, typer.Option(*OUT, help="The tokenizer file to write (.safetensors).")],
    steps: Annotated[int, typer.Option(help="Optimiser steps.")] = 2000,
    batch_size: Annotated[int, typer.Option(help="Chunks per step.")] = 256,
    lr: Annotated[float, typer.Option(help="Learning rate.")] = 1e-3,
    weight_decay: Annotated[float, typer.Option(help="Weight decay.")] = 1e-4,
    seed: Annotated[int, typer.Option(help="Decides everything that is drawn.")] = 0,
    preset: Annotated[str, _option("base or paper: values of the fields not given.")] = "base",
    normalization: Annotated[
        str | None, _option("Of actions: MEAN_STD, MIN_MAX, QUANTILES, ...; the ACTION entry of the mapping.")
    ] = None,
    norm_std_floor: Annotated[float | None, _option("Least spread that normalisation divides by.")] = None,
    chunk_size: Annotated[int | None, _option("Actions per chunk.")] = None,
    chunk_stride: Annotated[int | None, _option("Control steps between them.")] = None,
    tokenizer: Annotated[str | None, _option("residual_vq or fsq.")] = None,
    vqvae_num_layers: Annotated[int | None, _option("Levels: codes per chunk.")] = None,
    vqvae_n_embed: Annotated[int | None, _option("Codes to choose from on each level.")] = None,
    fsq_levels: Annotated[
        str | None, _option("Values of each dimension of an fsq code, such as 8,5,5.")
    ] = None,
    vqvae_coder: Annotated[str | None, _option("Encoder and decoder: mlp or conv.")] = None,
    vqvae_embedding_dim: Annotated[int | None, _option("Width of a code.")] = None,
    vqvae_enc_hidden_dim: Annotated[int | None, _option("Hidden width of encoder and decoder.")] = None,
    vqvae_decay: Annotated[float | None, _option("Of the codebook's moving average.")] = None,
    commitment_weight: Annotated[float | None, _option("How much encodings are drawn to codes.")] = None,
    kmeans_iters: Annotated[int | None, _option("Iterations that place the first codes; 0: random.")] = None,
    dead_code_threshold: Annotated[
        float | None, _option("Share of even use below which a code is placed anew; 0: never.")
    ] = None,
    rotation_trick: Annotated[
        bool | None, typer.Option(help="Gradients by rotation.", rich_help_panel="Fields of the policy")
    ] = None,
) -> None:
    """Train what turns chunks of actions into codes; reads no images. Interrupted, run the same again."""
    given = dict(locals())  # all of the above by name, before anything else has one
    from lerobot_act_chunking.policies.vqbet_chunked.tokenizer_file import TokenizerTraining
    from lerobot_act_chunking.policies.vqbet_chunked.tokenizer_training import plan_training

    training = TokenizerTraining(
        **{name: given.pop(name) for name in ("steps", "batch_size", "lr", "weight_decay", "seed")}
    )
    fields = {name: value for name, value in given.items() if value is not None}
    for name in ("dataset", "out", "preset"):
        del fields[name]
    if fsq_levels is not None:
        fields["fsq_levels"] = parse_numbers("fsq_levels", fsq_levels, "8,5,5")
    info, chunks = plan_training(dataset, preset, fields, training)
    console = Console()
    trained = _train(out, info, chunks, console)
    _print_card(trained, out, console)


def _train(output: Path, info: "TokenizerInfo", chunks: "ActionChunks", console: Console) -> "Trained":
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from lerobot_act_chunking.policies.vqbet_chunked.tokenizer_training import train_tokenizer

    numbers = TextColumn("L1 error {task.fields[error]:.4f} · codes in use {task.fields[used]:.1f}")
    columns = (TextColumn("training"), BarColumn(), MofNCompleteColumn(), numbers, TimeRemainingColumn())
    with Progress(*columns, console=console) as bar:
        line: list[Any] = []  # none before there is something to show: refusals come first

        def show(done: int, metrics: dict[str, float]) -> None:
            error, used = metrics["reconstruction_l1"], metrics["used_codes"]
            if not line:
                line.append(bar.add_task("training", total=info.training.steps, error=error, used=used))
            bar.update(line[0], completed=done, error=error, used=used)

        return train_tokenizer(output, info, chunks, show)


def _print_card(trained: "Trained", output: Path, console: Console) -> None:
    from rich.table import Table

    info, spec = trained.info, trained.info.spec
    if trained.steps_before == info.training.steps:
        console.print(f"{output} is there already, made with these settings", soft_wrap=True)
    elif trained.steps_before:
        console.print(f"went on from step {trained.steps_before}")
    table = Table("action", "mean error", "of its range", title="encoded and decoded again, in raw units")
    for (name, error), span in zip(trained.error.items(), trained.ranges, strict=True):
        table.add_row(name, f"{error:.4g}", f"{error / span:.1%}" if span else "-")
    console.print(table)
    for level, (used, spread) in enumerate(zip(trained.used_codes, trained.perplexity, strict=True), 1):
        console.print(
            f"level {level}: {used} codes used, as many as {spread:.1f} equally frequent ones would be"
        )
    console.print(
        f"chunks of {spec.chunk_size} actions, {info.chunk_stride} control steps apart, in "
        f"{info.normalization}: {trained.combinations} combinations of codes for {info.n_frames} chunks",
        soft_wrap=True,
    )
    console.print(
        f"use it: lerobot-train --policy.type=vqbet_chunked --policy.tokenizer_path={output} …",
        soft_wrap=True,
    )
