"""``act-chunking hub``: looking at, checking, cleaning and publishing a local hub."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from lerobot_act_chunking.hub.repository import Repository
    from lerobot_act_chunking.hub.storage import LocalHub
    from lerobot_act_chunking.hub.verifying import Report

app = typer.Typer(
    help="A model hub that is a folder (LEROBOT_LOCAL_HUB): list, show, verify, delete, publish, run.",
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
    hub = _hub(folder)
    for name in hub.names():
        repository = hub.open(name)
        head = repository.head("main") or "(damaged)"
        size = sum(path.stat().st_size for path in repository.blobs.glob("*")) / 1e6
        counts = f"{len(repository.revisions())} revisions, {len(repository.tags())} tags, {size:.1f} MB"
        typer.echo(f"{name.kind:8}{name.repo_id}  {head[:12]}  {counts}")


@app.command()
def show(
    repo_id: RepoId,
    revision: Annotated[str, typer.Option(help="Branch, tag or commit.")] = "main",
    kind: Kind = "model",
    folder: Folder = None,
) -> None:
    """One repository: its branches and tags, its history, and the files of a revision with their folder."""
    repository = _repository(folder, kind, repo_id)
    commit_id = repository.resolve(revision)
    tags = repository.tags()
    for name, target in repository.refs().items():
        typer.echo(f"{'tag' if name in tags else 'branch':8}{name}  {target[:12]}")
    for past, commit in repository.history(commit_id):
        typer.echo(f"{past[:12]}  {commit.date[:19]}  {commit.author}  {commit.title}")
    for path, entry in sorted(repository.commit(commit_id).files.items()):
        typer.echo(f"{entry.size / 1e6:10.3f} MB  {path}")
    typer.echo(f"in {repository.snapshots / commit_id}")


@app.command()
def verify(
    repo_id: Annotated[str | None, typer.Argument(help="org/name; every repository without it.")] = None,
    kind: Kind = "model",
    folder: Folder = None,
) -> None:
    """Compare every file with its checksum; exit status 11 if something is damaged."""
    from lerobot_act_chunking.diagnostics.outcome import EXIT_CODES
    from lerobot_act_chunking.hub.verifying import verify

    hub = _hub(folder)
    if repo_id is None:
        repositories = [hub.open(name) for name in hub.names()]
    else:
        repositories = [_repository(folder, kind, repo_id)]
    reports = [verify(repository) for repository in repositories]
    for report in reports:
        _print_report(report)
    if any(report.problems for report in reports):
        raise typer.Exit(EXIT_CODES["fail"])


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
    from lerobot_act_chunking.hub.collecting import delete_history, delete_revision

    if history and revision is not None:
        raise ConfigurationError("--history and --revision exclude each other")
    hub, repository = _hub(folder), _repository(folder, kind, repo_id)
    if revision is None and not history:
        hub.delete(repository.name)
        typer.echo(f"deleted {repository.folder}")
        return
    with hub.lock(repository.name):
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

    from lerobot_act_chunking.hub.sharing import publish

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


def _print_report(report: Report) -> None:
    state = f"{len(report.problems)} problems" if report.problems else "intact"
    typer.echo(f"{report.kind} {report.repo_id}: {state}, {len(report.intact)} revisions load")
    for problem in report.problems:
        typer.echo(f"  {problem}")
    if report.problems:
        typer.echo(f"  still loads: {', '.join(report.loadable) or 'nothing'}")
    if report.unreferenced:
        held = f"{report.unreferenced / 1e6:.1f} MB"
        typer.echo(f"  {held} held by interrupted pushes; 'hub delete --history' frees them after an hour")
