"""Verification finds damage and says what still loads; deletion frees exactly what nothing shows any more."""

import os
from pathlib import Path

import pytest
from huggingface_hub import HfApi, scan_cache_dir, snapshot_download

from lerobot_act_chunking.hub import garbage_collection, publishing
from lerobot_act_chunking.hub.names import RepoName
from lerobot_act_chunking.hub.refusal import RefusedError
from lerobot_act_chunking.hub.repository import Repository
from lerobot_act_chunking.hub.storage import LocalHub
from lerobot_act_chunking.hub.verifying import verify

MODEL = RepoName("model", "me/act")


@pytest.fixture
def versions(api: HfApi, folder: Path) -> list[str]:
    """Three revisions with different weights; the first two are tagged v1 and v2."""
    api.create_repo("me/act")
    commits = []
    for number in range(3):
        (folder / "model.safetensors").write_bytes(os.urandom(70_000 + number))
        commits.append(
            api.upload_folder(repo_id="me/act", folder_path=folder, commit_message=f"v{number + 1}").oid
        )
    api.create_tag("me/act", tag="v1", revision=commits[0])
    api.create_tag("me/act", tag="v2", revision=commits[1])
    return commits


@pytest.fixture
def repository(hub: LocalHub, versions: list[str]) -> Repository:
    return hub.open(MODEL)


def weights_blob(repository: Repository, commit_id: str) -> Path:
    return repository.blob(repository.commit(commit_id).files["model.safetensors"].digest)


def flip_a_byte(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def test_an_intact_repository_has_no_problems(repository: Repository, versions: list[str]):
    report = verify(repository)
    assert (report.problems, report.damaged, report.unreferenced) == ([], [], 0)
    assert report.loadable[:3] == ["main", "v1", "v2"]
    assert set(versions) < set(report.intact)


def test_a_flipped_byte_damages_only_the_revisions_that_show_it(repository: Repository, versions: list[str]):
    blob = weights_blob(repository, versions[1])
    flip_a_byte(blob)
    report = verify(repository)
    assert report.damaged == [versions[1]]
    [problem] = report.problems
    assert "model.safetensors" in problem
    assert blob.name in problem
    assert "hub repair me/act, then push that file again" in problem
    assert report.loadable[:2] == ["main", "v1"]


def test_a_missing_blob_and_a_truncated_one(repository: Repository, versions: list[str]):
    weights_blob(repository, versions[0]).unlink()
    with weights_blob(repository, versions[2]).open("r+b") as file:
        file.truncate(10)
    report = verify(repository)
    assert report.damaged == [versions[0], versions[2]]
    assert "is missing" in report.problems[0]
    assert "has 10 bytes instead of 70002" in report.problems[1]
    assert report.loadable[0] == "v2"


def test_a_broken_ref(repository: Repository, versions: list[str]):
    (repository.ref_folder / "v1").write_text("garbage")
    (repository.ref_folder / "main").write_text("1" * 40)
    report = verify(repository)
    assert len(report.problems) == 2
    assert "ref 'main' names '1111" in report.problems[0]
    assert "ref 'v1' names 'garbage', which is not a revision; repair it with" in report.problems[1]
    assert report.loadable[0] == "v2"
    assert set(versions) <= {*report.loadable, *(report.names[name] for name in ("v2",))}


def test_a_damaged_description_and_a_stray_file(repository: Repository, versions: list[str]):
    flip_a_byte(repository.commit_folder / f"{versions[0]}.json")
    (repository.snapshots / versions[1] / "stray.txt").touch()
    report = verify(repository)
    assert report.damaged == versions[:2]
    assert "is damaged" in report.problems[0]
    assert "added by hand" in report.problems[1]


@pytest.mark.parametrize("damage", ["flipped", "missing"])
def test_pushing_the_same_files_again_mends_a_blob(
    api: HfApi, repository: Repository, versions: list[str], folder: Path, damage: str
):
    for name in ("model.safetensors", "config.json"):
        blob = repository.blob(repository.commit(versions[2]).files[name].digest)
        if damage == "flipped":
            flip_a_byte(blob)
            assert f"{blob} does not match" in " ".join(verify(repository).problems)
        blob.unlink()
    api.upload_folder(repo_id="me/act", folder_path=folder)
    assert verify(repository).problems == []


def test_a_push_does_not_carry_on_with_a_broken_branch(api: HfApi, repository: Repository, folder: Path):
    (repository.ref_folder / "main").write_text("garbage")
    from huggingface_hub.errors import HfHubHTTPError

    with pytest.raises(HfHubHTTPError):
        api.upload_folder(repo_id="me/act", folder_path=folder / "sub")


def blobs(repository: Repository) -> set[str]:
    return {path.name for path in repository.blobs.iterdir()}


def test_deleting_a_tag_frees_only_what_it_alone_showed(
    hub: LocalHub, repository: Repository, versions: list[str]
):
    before, gone = blobs(repository), weights_blob(repository, versions[0]).name
    with hub.lock(MODEL):
        freed = garbage_collection.delete_revision(repository, "v1")
    assert (freed.revisions, freed.blobs, freed.size) == (1, 1, 70_000)
    assert blobs(repository) == before - {gone}
    assert verify(repository).problems == []
    assert scan_cache_dir(hub.root).warnings == []
    assert Path(snapshot_download("me/act", revision="v2")).is_dir()


def test_deleting_a_name_of_a_revision_with_another_name_frees_nothing(repository: Repository, api: HfApi):
    api.create_tag("me/act", tag="best", revision="v1")
    before = blobs(repository)
    assert garbage_collection.delete_revision(repository, "best") == garbage_collection.Freed(0, 0, 0)
    assert blobs(repository) == before
    assert "v1" in verify(repository).loadable


def test_a_named_revision_is_not_deleted_by_its_id(repository: Repository, versions: list[str]):
    with pytest.raises(RefusedError, match="still named by v1; delete those names instead"):
        garbage_collection.delete_revision(repository, versions[0])
    with pytest.raises(RefusedError, match="cannot be deleted"):
        garbage_collection.delete_revision(repository, "main")


def test_deleting_history_keeps_names_and_what_they_show(
    repository: Repository, versions: list[str], api: HfApi
):
    api.delete_tag("me/act", tag="v2")
    gone = weights_blob(repository, versions[1]).name
    freed = garbage_collection.delete_history(repository)
    assert (freed.revisions, freed.blobs) == (2, 1)  # the untagged one and the empty first one
    assert gone not in blobs(repository)
    assert repository.revisions() == [versions[0], versions[2]]
    assert [commit_id for commit_id, _ in repository.history(versions[2])] == [versions[2]]
    assert verify(repository).problems == []


def test_history_is_not_dropped_while_main_is_damaged(repository: Repository):
    (repository.ref_folder / "main").write_text("garbage")
    with pytest.raises(RefusedError, match="repair it with: act-chunking hub repair me/act"):
        garbage_collection.delete_history(repository)


def test_a_blob_that_a_push_under_way_announced_survives_deletion(
    repository: Repository, versions: list[str]
):
    entry = repository.commit(versions[0]).files["model.safetensors"]
    assert publishing.renew_blob(repository, entry)  # what the LFS batch does before the commit
    freed = garbage_collection.delete_revision(repository, "v1")
    assert (freed.revisions, freed.blobs) == (1, 0)
    assert repository.has_blob(entry)
    assert verify(repository).unreferenced == entry.size


@pytest.mark.parametrize("newest", [0, 1])
def test_of_several_dropped_revisions_the_newest_that_showed_a_blob_counts(
    repository: Repository, api: HfApi, folder: Path, newest: int
):
    """A blob announced between two of them belongs to the newer one, in whatever order they are dropped."""
    (folder / "notes.bin").write_bytes(b"of two revisions")
    dropped = []
    for number in range(2):
        (folder / "model.safetensors").write_bytes(os.urandom(60_000 + number))
        dropped.append(api.upload_folder(repo_id="me/act", folder_path=folder).oid)
    api.delete_file("notes.bin", "me/act")
    (blob,) = {repository.blob(repository.commit(each).files["notes.bin"].digest) for each in dropped}
    announced = blob.lstat().st_mtime
    for number, commit_id in enumerate(dropped):
        moment = announced + (100 if number == newest else -100)
        os.utime(repository.commit_folder / f"{commit_id}.json", (moment, moment))
    garbage_collection.delete_history(repository)
    assert not blob.exists()


def test_what_killed_pushes_left_is_freed_when_it_is_old(
    repository: Repository, versions: list[str], monkeypatch: pytest.MonkeyPatch
):
    publishing.receive_blob(repository, [b"never committed"])
    (repository.incoming / "half").write_bytes(b"half a body")
    assert garbage_collection.delete_history(repository).blobs == 0
    assert verify(repository).unreferenced == len(b"never committed") + len(b"half a body")
    for module in (garbage_collection, publishing):
        monkeypatch.setattr(module, "ABANDONED", 0.0)
    assert garbage_collection.delete_history(repository).blobs == 1
    assert verify(repository).unreferenced == 0
    assert publishing.leftovers(repository) == []


def test_without_symlinks_deletion_still_knows_which_blobs_are_shown(
    hub: LocalHub, api: HfApi, folder: Path, monkeypatch: pytest.MonkeyPatch
):
    def refuse(self: Path, target: object, *_: object) -> None:
        raise PermissionError("no links here")

    monkeypatch.setattr(Path, "symlink_to", refuse)
    monkeypatch.setattr(Path, "hardlink_to", refuse)
    api.create_repo("me/act")
    api.upload_folder(repo_id="me/act", folder_path=folder)
    repository = hub.open(MODEL)
    before = blobs(repository)
    garbage_collection.delete_history(repository)
    assert blobs(repository) == before
    (folder / "model.safetensors").write_bytes(os.urandom(70_000))
    api.upload_folder(repo_id="me/act", folder_path=folder)
    assert garbage_collection.delete_history(repository).blobs == 1
    assert verify(repository).problems == []
