"""Damage to one repository's folder is one repository's problem, is named, and is cured as advised."""

import hashlib
import itertools
import os
import random
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from damaging import damage
from huggingface_hub import CommitOperationAdd, HfApi, set_client_factory, snapshot_download
from huggingface_hub.errors import HfHubHTTPError, LocalEntryNotFoundError
from huggingface_hub.utils._http import default_client_factory
from tiers import draws
from typer.testing import CliRunner

from lerobot_act_chunking.cli.hub import app
from lerobot_act_chunking.diagnostics.core.report import EXIT_CODES
from lerobot_act_chunking.errors import ActChunkingError
from lerobot_act_chunking.hub.commits import Commit
from lerobot_act_chunking.hub.names import RepoName
from lerobot_act_chunking.hub.routing import route_to
from lerobot_act_chunking.hub.storage import LocalHub
from lerobot_act_chunking.hub.verifying import Report, verify_named

NAMES = [RepoName("model", "me/act"), RepoName("dataset", "me/cube"), RepoName("model", "me/downloaded")]
DOWNLOADED = NAMES[2]
Table = dict[tuple[RepoName, str], dict[str, bytes]]
"""The files of every revision of every repository."""


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A hub with three repositories: two that were pushed to, one that huggingface_hub downloaded."""
    folder = tmp_path_factory.mktemp("template")
    hub, api = LocalHub(folder / "hub"), HfApi()
    route_to(hub)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Commit, "now", numbered_commits())
        fill(hub, api, folder)
    yield hub.root
    set_client_factory(default_client_factory)


def numbered_commits() -> Callable[..., Commit]:
    """In place of ``Commit.now``: the ids, and with them the damages, are the same in every run."""
    make, numbers = Commit.now, itertools.count()

    def now(**fields: Any) -> Commit:
        number = next(numbers)
        date = f"2026-01-01T00:00:{number:02}+00:00"
        return replace(make(**fields), author="me", date=date, nonce=str(number))

    return now


def fill(hub: LocalHub, api: HfApi, folder: Path) -> None:
    for name in NAMES:
        api.create_repo(name.repo_id, repo_type=name.kind)
        for number, tag in enumerate(["v1", "v2"]):
            for path in ("config.json", f"sub/{number}.txt"):
                content = f"{name} {path} {number}".encode()
                api.upload_file(
                    path_or_fileobj=content, path_in_repo=path, repo_id=name.repo_id, repo_type=name.kind
                )
            api.create_tag(name.repo_id, tag=tag, repo_type=name.kind)
        api.create_branch(name.repo_id, branch="trials/a", revision="v1", repo_type=name.kind)
    pushed = hub.root / NAMES[2].folder
    for revision in ("main", "v1"):
        snapshot_download("me/downloaded", revision=revision, cache_dir=folder / "cache")
    shutil.rmtree(pushed)
    (folder / "cache" / NAMES[2].folder).rename(pushed)


@pytest.fixture
def world(template: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[LocalHub, Path, Table]:
    """A copy of the hub that huggingface_hub is routed to, a folder outside, and what the hub should hold."""
    shutil.copytree(template, tmp_path / "hub", symlinks=True)
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / "secret").write_text("what nobody may read")
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)  # power cuts are not this test's damage
    hub = LocalHub(tmp_path / "hub")
    route_to(hub)
    return hub, tmp_path / "outside", contents(hub)


def contents(hub: LocalHub) -> Table:
    found: Table = {}
    for name in NAMES:
        for snapshot in (hub.root / name.folder / "snapshots").iterdir():
            files = [path for path in snapshot.rglob("*") if path.is_file()]
            found[name, snapshot.name] = {
                path.relative_to(snapshot).as_posix(): path.read_bytes() for path in files
            }
    return found


def command(hub: LocalHub, *arguments: str) -> tuple[int, list[str]]:
    """Exit code and lines of a command; refusals count as an exit, anything else is a failure."""
    result = CliRunner().invoke(app, [*arguments, "--dir", str(hub.root)])
    if isinstance(result.exception, ActChunkingError):
        return 1, [str(result.exception)]
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.output.splitlines()


def small(path: Path) -> bool:
    return path.is_file() and path.stat().st_size < 1 << 20


def shown(hub: LocalHub, name: RepoName, revision: str) -> dict[str, bytes]:
    """A revision as any huggingface_hub reads it from the folder, offline."""
    folder = hub.root / name.folder / "snapshots" / revision
    files = [path for path in sorted(folder.rglob("*")) if small(path) and inside(path, hub.root)]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def inside(path: Path, folder: Path) -> bool:
    return path.resolve().is_relative_to(folder.resolve())


def heads(hub: LocalHub, name: RepoName) -> dict[str, str]:
    folder = hub.root / name.folder / "refs"
    return {ref: (folder / ref).read_text() for ref in ("main", "v1", "v2") if (folder / ref).is_file()}


def harmed(hub: LocalHub, victim: RepoName, table: Table, before: dict[str, str]) -> list[str]:
    """What does not load as it did. Of downloads nobody knows which files they had."""
    lost = [
        f"revision {revision}"
        for (name, revision), files in table.items()
        if name == victim != DOWNLOADED and shown(hub, name, revision) != files
    ]
    paths = {ref: hub.root / victim.folder / "refs" / ref for ref in before}
    return lost + [
        f"ref {ref}"
        for ref, path in paths.items()
        if not (small(path) and inside(path, hub.root) and path.read_bytes() == before[ref].encode())
    ]


def digests(folder: Path) -> set[str]:
    """Every content that a repository still holds, whatever it is called."""
    found = [path for path in folder.rglob("*") if not path.is_symlink()]
    return {hashlib.sha256(path.read_bytes()).hexdigest() for path in found if small(path)}


def loads(name: RepoName, revision: str, target: Path) -> dict[str, bytes]:
    folder = Path(snapshot_download(name.repo_id, repo_type=name.kind, revision=revision, cache_dir=target))
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()
    }


def push(name: RepoName, files: dict[str, bytes]) -> str:
    added = [CommitOperationAdd(path, content) for path, content in files.items()]
    done = HfApi().create_commit(name.repo_id, added, commit_message="files", repo_type=name.kind)
    return done.oid


def follow(hub: LocalHub, name: RepoName, problems: list[str], table: Table) -> None:
    """Do what verify's advice says: repairs first, else one push of all that is lost."""
    text = "\n".join(problems)
    if found := re.search(
        r"(\S+) leads out of \S+ through a symlink; replace the link by what it leads to", text
    ):
        link = Path(found[1])
        target = link.resolve()
        link.unlink()
        if target.exists() and "moved-" in target.name:
            target.rename(link)
    elif found := re.search(r"(\S+) is no folder; move it out of the hub", text):
        Path(found[1]).rename(hub.root.parent / "moved-out")
    elif found := re.search(r"repair it with: act-chunking hub (repair [^,;\n]+)", text):
        command(hub, *found[1].split())
    else:
        lost = [
            re.search(r"revision (\w+), file (.*): blob (\w+) is missing; push", line) for line in problems
        ]
        assert all(lost), f"no advice in {problems}"
        known = {
            hashlib.sha256(content).hexdigest(): content
            for files in table.values()
            for content in files.values()
        }
        head, files = hub.open(name).head("main"), {}
        for revision, path, digest in (match.groups() for match in lost if match):
            files[path if revision == head else f"restored/{digest}"] = known[digest]
        push(name, files)


def cure(hub: LocalHub, name: RepoName, table: Table) -> Report:
    """Follow verify's advice until it has none; it must not go round in a circle."""
    for _ in range(6):
        report = verify_named(hub, name)
        if not report.problems or not os.path.lexists(hub.root / name.folder):
            return report
        follow(hub, name, report.problems, table)
    raise AssertionError(f"advice in a circle: {report.problems}")


@pytest.mark.parametrize("seed", range(draws(10, 500)))
def test_damage_is_one_repositorys_problem_and_the_advice_cures(
    world: tuple[LocalHub, Path, Table], tmp_path: Path, seed: int
):
    hub, outside, table = world
    rng = random.Random(seed)
    victim, others = NAMES[seed % 3], [name for name in NAMES if name != NAMES[seed % 3]]
    listed, before = command(hub, "list")[1], heads(hub, victim)
    made = [
        damage(rng, hub.root / victim.folder, outside)
        for _ in range(rng.randint(1, 3))
        if (hub.root / victim.folder).is_dir()
    ]
    print(made)

    # Every other repository is listed, verified and loaded; nothing raises.
    status, lines = command(hub, "list")
    assert status == 0
    assert {line for line in listed if victim.repo_id not in line} <= set(lines)
    _, verified = command(hub, "verify")
    for name in others:
        intact = f"{name.kind} {name.repo_id}: intact, {sum(key[0] == name for key in table)} revisions load"
        assert intact in verified
    command(hub, "show", victim.repo_id, "--type", victim.kind)
    name = rng.choice(others)
    assert loads(name, "v1", tmp_path / "cache") == table[name, heads(hub, name)["v1"]]
    assert push(name, {"new.txt": b"new"}) in command(hub, "show", name.repo_id, "--type", name.kind)[1][-1]

    # What does not load as it did is named.
    report, lost = verify_named(hub, victim), harmed(hub, victim, table, before)
    if hub.holds(victim) and lost:
        assert report.problems + report.notes, lost

    # Loads and pushes of the damaged one work or are refused, and destroy nothing.
    kept = digests(hub.root / victim.folder)
    if rng.random() < 0.5:
        try:
            loads(victim, "main", tmp_path / "cache")
            oid = push(victim, {"new.txt": b"pushed"})
            assert loads(victim, oid, tmp_path / "cache")["new.txt"] == b"pushed"
        except (HfHubHTTPError, LocalEntryNotFoundError):
            pass
        kept -= {hashlib.sha256(said.encode()).hexdigest() for said in before.values()}
        assert kept <= digests(hub.root / victim.folder)

    # The advice cures, and loses nothing.
    report = cure(hub, victim, table)
    if hub.holds(victim):
        assert report.problems == []
        kept -= {hashlib.sha256(said.encode()).hexdigest() for said in before.values()}
        assert kept <= digests(hub.root / victim.folder)
        oid = push(victim, {"last.txt": b"last"})
        assert loads(victim, oid, tmp_path / "cache")["last.txt"] == b"last"
        assert verify_named(hub, victim).problems == []


ACT = NAMES[0]


def test_a_lost_main_is_named_and_repaired_where_all_descriptions_are_lost_too(
    world: tuple[LocalHub, Path, Table],
):
    hub, _, table = world
    head = hub.open(ACT).resolve("main")
    shutil.rmtree(hub.root / ACT.folder / ".hub" / "commits")
    (hub.root / ACT.folder / ".hub" / "commits").mkdir()
    os.utime(hub.root / ACT.folder / "snapshots" / head)
    (hub.root / ACT.folder / "refs" / "main").unlink()
    (problem,) = verify_named(hub, ACT).problems
    assert "refs/main is missing or a folder" in problem
    assert cure(hub, ACT, table).problems == []
    assert hub.open(ACT).resolve("main") == head


def test_a_lost_main_is_named_and_repaired_to_the_newest_revision(world: tuple[LocalHub, Path, Table]):
    hub, _, table = world
    head = hub.open(ACT).resolve("main")
    (hub.root / ACT.folder / "refs" / "main").unlink()
    status, lines = command(hub, "verify")
    assert status == EXIT_CODES["fail"]
    assert any(
        "refs/main is missing or a folder; repair it with: act-chunking hub repair me/act" in line
        for line in lines
    )
    with pytest.raises(HfHubHTTPError, match="repair it with"):
        push(ACT, {"new.txt": b"new"})
    assert cure(hub, ACT, table).problems == []
    assert hub.open(ACT).resolve("main") == head


def test_a_push_goes_on_where_the_folders_of_revisions_are_lost(world: tuple[LocalHub, Path, Table]):
    hub, _, table = world
    head = hub.open(ACT).resolve("main")
    shutil.rmtree(hub.root / ACT.folder / "snapshots")
    oid = push(ACT, {"new.txt": b"new"})
    assert shown(hub, ACT, oid) == table[ACT, head] | {"new.txt": b"new"}


def test_a_push_does_not_pass_on_a_lost_file(world: tuple[LocalHub, Path, Table]):
    hub, _, table = world
    repository = hub.open(ACT)
    head = repository.resolve("main")
    repository.blob(repository.commit(head).files["config.json"].digest).unlink()
    with pytest.raises(
        HfHubHTTPError, match=r"'config.json' in 'me/act' is lost or damaged; push that file too"
    ):
        push(ACT, {"new.txt": b"new"})
    with pytest.raises(LocalEntryNotFoundError) as failure:
        HfApi().hf_hub_download("me/act", "config.json", cache_dir=hub.root.parent / "cache")
    assert "'config.json' of 'me/act' is lost" in str(failure.value.__cause__)
    assert push(ACT, {"new.txt": b"new", "config.json": table[ACT, head]["config.json"]})
    assert verify_named(hub, ACT).problems == []
