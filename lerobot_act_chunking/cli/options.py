"""Options that several commands share, and how their values are read."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

if TYPE_CHECKING:
    from lerobot_act_chunking.executors import Cluster

OUT = ("--out", "--output")
"""What a command makes: a checkpoint, a file of codes, or a picture."""


def to_a_file(option: typer.CallbackParam, path: Path | None) -> Path | None:
    """Refuse, before anything runs, what cannot be written to.

    Raises:
        ConfigurationError: the name ``-`` (others print too, so that what goes to standard output would be
            no JSON), a folder, or a place below a file.
    """
    from lerobot_act_chunking.errors import ConfigurationError

    name = option.opts[0]
    if path == Path("-"):
        raise ConfigurationError(
            f"{name}=- would mix what is written with tables and messages on standard output: name a file"
        )
    if path is not None and path.is_dir():
        raise ConfigurationError(f"{name}={path} is a folder: name a file in it")
    _check_parents(name, path)
    return path


def to_a_folder(option: typer.CallbackParam, path: Path | None) -> Path | None:
    """Refuse, before anything runs, what cannot be a folder.

    Raises:
        ConfigurationError: a file, or a place below one.
    """
    from lerobot_act_chunking.errors import ConfigurationError

    if path is not None and path.is_file():
        raise ConfigurationError(f"{option.opts[0]}={path} is a file: name a folder")
    _check_parents(option.opts[0], path)
    return path


def _check_parents(name: str, path: Path | None) -> None:
    from lerobot_act_chunking.errors import ConfigurationError

    if path is not None and (above := next(filter(Path.exists, path.absolute().parents))).is_file():
        raise ConfigurationError(f"{name}={path} cannot be made: {above} is a file")


Picture = Annotated[Path | None, typer.Option(*OUT, callback=to_a_file, help="Draw a PNG.")]
Json = Annotated[Path | None, typer.Option(callback=to_a_file, help="Write every number to this file.")]
PolicyFields = Annotated[
    list[str] | None,
    typer.Option(
        "--policy.FIELD",
        metavar="VALUE",
        help="Any setting of the policy, in place of the checkpoint's: --policy.max_speed=1.5.",
    ),
]
"""For a `PolicyCommand`."""
Workers = Annotated[
    int | None,
    typer.Option(
        help="Processes that run episodes; the results are the same. \\[default: 2, or 1 on one core; with "
        "--executor=ray one on each CPU of the cluster]"
    ),
]
Executor = Annotated[
    Literal["local", "ray"],
    typer.Option(help="Whose processes: this machine's, or those of a Ray cluster."),
]
Address = Annotated[
    str | None,
    typer.Option(
        help="With --executor=ray: of the cluster, as HOST:6379, auto or ray://HOST:10001. \\[default: a Ray "
        "of this machine, for this command]"
    ),
]


def asked_workers(
    workers: int | None, executor: str, address: str | None, default: int | None = None
) -> "tuple[int, Cluster | None]":
    """How many workers, and of which cluster; None of this machine.

    Args:
        workers: of `Workers`.
        executor: of `Executor`.
        address: of `Address`.
        default: how many there are on this machine; None for two, or one on one core.

    Raises:
        ConfigurationError: an address without Ray, no Ray here, or none at the address.
    """
    from act_chunking_runtime.number_checks import check_at_least
    from lerobot_act_chunking.errors import ConfigurationError
    from lerobot_act_chunking.executors import Cluster

    if workers is not None:
        check_at_least(1, workers=workers)
    if executor == "ray":
        cluster = Cluster(address)
        return cluster.connect(workers), cluster
    if address is not None:
        raise ConfigurationError(f"--address={address} is of a Ray cluster: give --executor=ray as well")
    return workers or default or min(2, os.cpu_count() or 1), None


def whole_numbers(text: str, refusal: Exception, *, gaps: bool = False) -> tuple[int, ...]:
    """Numbers with commas between them.

    Args:
        text: such as ``2,5,10``.
        refusal: what to raise if there is anything else in it.
        gaps: whether there may be nothing between two commas, or in all of the text.
    """
    parts = [part for part in text.split(",") if part.strip() or not gaps]
    try:
        return tuple(map(int, parts))
    except ValueError:
        raise refusal from None


def parse_numbers(name: str, text: str | None, example: str = "2,5,10") -> tuple[int, ...]:
    """Numbers with commas between them, of the option ``name``; none if it was not given.

    Raises:
        ConfigurationError: naming the option, its value and an example.
    """
    from lerobot_act_chunking.errors import ConfigurationError

    if text is None:
        return ()
    message = f"{name}={text!r} must be numbers with commas between them: {example}"
    return whole_numbers(text, ConfigurationError(message))
