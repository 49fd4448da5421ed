"""``act-chunking hub``: looking at, checking, repairing, cleaning and publishing a local hub."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from lerobot_act_chunking.hub.names import RepoName
    from lerobot_act_chunking.hub.repository import Repository
    from lerobot_act_chunking.hub.storage import LocalHub
    from lerobot_act_chunking.hub.verifying import Report

app = typer.Typer(
    help="A model hub that is a folder (LEROBOT_LOCAL_HUB): look at it, check, repair, clean, publish it.",
    no_args_is_help=True,
)

Folder = Annotated[
    Path | None,
    typer.Option("--dir", envvar="LEROBOT_LOCAL_HUB", help="The hub's folder.", show_default=False),
]
Kind = Annotated[str, typer.Option("--type", help="model, dataset or space.")]
RepoId = Annotated[str, typer.Argument(help="org/name")]


@app.command("list")
def list_(folder: Folder = None) -> None:
    """Every repository: its newest revision, its tags, its size on disk."""
    from lerobot_act_chunking.hub.refusal import RefusedError

    hub = _hub(folder)
    for name in _names(hub):
        try:
            about = _summary(hub.open(name))
        except (RefusedError, OSError) as error:
            about = f"(damaged)  {error}"
        _say(f"{name.kind:8}{name.repo_id}  {about}")


@app.command()
def show(
    repo_id: RepoId,
    revision: Annotated[str, typer.Option(help="Branch, tag, or (the first digits of) a commit.")] = "main",
    kind: Kind = "model",
    folder: Folder = None,
) -> None:
    """One repository: its branches and tags, its history, and the files of a revision with their folder."""
    with _disk_refusals():
        for line in _description(_repository(folder, kind, repo_id), revision):
            _say(line)


@app.command()
def verify(
    repo_id: Annotated[str | None, typer.Argument(help="org/name; every repository without it.")] = None,
    kind: Kind = "model",
    folder: Folder = None,
) -> None:
    """Compare every file with its checksum; exit status 11 if something is damaged."""
    from lerobot_act_chunking.diagnostics.core.report import EXIT_CODES
    from lerobot_act_chunking.hub.verifying import verify_named

    hub = _hub(folder)
    names = _names(hub) if repo_id is None else [_repository(folder, kind, repo_id).name]
    reports = []
    for name in names:
        reports.append(verify_named(hub, name))
        _print_report(reports[-1])
    if any(report.problems for report in reports):
        raise typer.Exit(EXIT_CODES["fail"])


@app.command()
def repair(repo_id: RepoId, kind: Kind = "model", folder: Folder = None) -> None:
    """Restore what a repository's own files can restore; what is in the way is moved aside, never deleted."""
    from lerobot_act_chunking.hub.repairing import repair

    with _disk_refusals():
        hub, repository = _hub(folder), _repository(folder, kind, repo_id)
        with hub.lock(repository.name):
            done = repair(repository)
    for line in done or ["there was nothing to repair"]:
        _say(line)
    _say(f"contents that are lost have to be pushed again: {repository.name.command('verify')} names them")


@app.command()
def delete(
    repo_id: RepoId,
    revision: Annotated[str | None, typer.Option(help="Only this tag, branch or unnamed commit.")] = None,
    history: Annotated[bool, typer.Option(help="Only revisions without a branch or tag.")] = False,
    kind: Kind = "model",
    folder: Folder = None,
) -> None:
    """Delete a repository, one revision, or its unnamed history; files that other revisions show stay."""
    from lerobot_act_chunking.errors import ConfigurationError
    from lerobot_act_chunking.hub.garbage_collection import delete_history, delete_revision

    if history and revision is not None:
        raise ConfigurationError("--history and --revision exclude each other")
    hub, repository = _hub(folder), _repository(folder, kind, repo_id)
    if revision is None and not history:
        with _disk_refusals():
            hub.delete(repository.name)
        typer.echo(f"deleted {repository.folder}")
        return
    with _disk_refusals(), hub.lock(repository.name):
        freed = delete_history(repository) if revision is None else delete_revision(repository, revision)
    typer.echo(f"dropped {freed.revisions} revisions, freed {freed.blobs} files ({freed.size / 1e6:.1f} MB)")


@app.command()
def publish(
    repo_id: RepoId,
    to: Annotated[str | None, typer.Option(help="Its name on the real Hub, if another one.")] = None,
    private: Annotated[bool, typer.Option(help="Create it there as private.")] = False,
    kind: Kind = "model",
    folder: Folder = None,
) -> None:
    """Push a repository's tags and newest revision to the real Hugging Face Hub, which needs a login."""
    from huggingface_hub import HfApi

    from lerobot_act_chunking.hub.upload import publish

    # This process never called install(), so HfApi speaks to the real Hub although the variable is set.
    for address in publish(_repository(folder, kind, repo_id), HfApi(), repo_id=to, private=private):
        typer.echo(address)


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True})
def run(
    context: typer.Context,
    command: Annotated[str, typer.Argument(help="A command of LeRobot.")],
) -> None:
    """Run a LeRobot command that does not load plugins (lerobot-edit-dataset, ...) with the local hub."""
    import sys
    from importlib.metadata import entry_points

    from lerobot_act_chunking.errors import unknown_choice
    from lerobot_act_chunking.hub import install

    scripts = {script.name: script for script in entry_points(group="console_scripts")}
    if command not in scripts:
        raise unknown_choice(
            "command", command, sorted(name for name in scripts if name.startswith("lerobot-"))
        )
    _hub(None)
    install()
    sys.argv = [command, *context.args]
    scripts[command].load()()


def _hub(folder: Path | None) -> LocalHub:
    from lerobot_act_chunking.errors import ConfigurationError
    from lerobot_act_chunking.hub.storage import LocalHub

    chosen = folder or os.environ.get("LEROBOT_LOCAL_HUB")
    if not chosen:
        raise ConfigurationError("which hub? set LEROBOT_LOCAL_HUB or give --dir")
    return LocalHub(chosen)


def _repository(folder: Path | None, kind: str, repo_id: str) -> Repository:
    from lerobot_act_chunking.hub.names import RepoName

    hub = _hub(folder)
    return hub.open(hub.full_name(RepoName.checked(kind, repo_id)))


def _names(hub: LocalHub) -> list[RepoName]:
    with _disk_refusals():
        return hub.names()


def _summary(repository: Repository) -> str:
    head = (repository.head("main") or "(damaged)")[:12]
    size = sum(path.lstat().st_size for path in repository.blobs.glob("*")) / 1e6
    counts = f"{len(repository.revisions())} revisions, {len(repository.tags())} tags, {size:.1f} MB"
    return f"{head}  {counts}"


def _description(repository: Repository, revision: str) -> Iterator[str]:
    commit_id, tags = repository.resolve(revision), repository.tags()
    for name, target in repository.refs().items():
        yield f"{'tag' if name in tags else 'branch':8}{name}  {target[:12]}"
    for past, commit in repository.history(commit_id):
        yield f"{past[:12]}  {commit.date[:19]}  {commit.author}  {commit.title}"
    for path, entry in sorted(repository.commit(commit_id).files.items()):
        yield f"{entry.size / 1e6:10.3f} MB  {path}"
    yield f"in {repository.snapshots / commit_id}"


@contextmanager
def _disk_refusals() -> Iterator[None]:
    """Errors of the disk end a command with their message instead of a traceback."""
    from lerobot_act_chunking.hub.refusal import RefusedError

    try:
        yield
    except OSError as error:
        raise RefusedError(f"the hub's folder does not allow that: {error}") from error


def _say(line: str) -> None:
    """One line, whatever characters the names in the folder are made of."""
    from lerobot_act_chunking.hub.names import printable

    typer.echo(printable(line))


def _print_report(report: Report) -> None:
    state = f"{len(report.problems)} problems" if report.problems else "intact"
    _say(f"{report.kind} {report.repo_id}: {state}, {len(report.intact)} revisions load")
    for problem in report.problems:
        _say(f"  {problem}")
    for note in report.notes:
        _say(f"  note: {note}")
    if report.problems:
        _say(f"  still loads: {', '.join(report.loadable) or 'nothing'}")
    if report.unreferenced:
        held = f"{report.unreferenced / 1e6:.1f} MB"
        _say(f"  {held} held by interrupted pushes; 'hub delete --history' frees them after an hour")
