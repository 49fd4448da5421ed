"""huggingface_hub's own client against the local hub, call by call."""

import json
import logging
from pathlib import Path

import httpx
import pytest
from checkpoint_files import FILES
from huggingface_hub import (
    CommitOperationAdd,
    CommitOperationCopy,
    HfApi,
    HfFileSystem,
    ModelCard,
    get_session,
    hf_hub_download,
    scan_cache_dir,
    snapshot_download,
)
from huggingface_hub.errors import (
    BadRequestError,
    EntryNotFoundError,
    HfHubHTTPError,
    OfflineModeIsEnabled,
    RepositoryNotFoundError,
    RevisionNotFoundError,
)
from tiers import full_tier

from lerobot_act_chunking.hub.storage import LocalHub, owner_name
from lerobot_act_chunking.hub.transport import LocalHubTransport


def test_pushed_files_load_back_equal_and_scan_without_warnings(hub: LocalHub, api: HfApi, folder: Path):
    api.create_repo("me/act", exist_ok=True)
    pushed = api.upload_folder(repo_id="me/act", folder_path=folder)

    loaded = Path(snapshot_download("me/act"))
    assert loaded.name == pushed.oid
    assert api.list_repo_files("me/act") == FILES
    for name in FILES:
        assert (loaded / name).read_bytes() == (folder / name).read_bytes()
    assert pushed.repo_url == "https://huggingface.co/me/act"

    scan = scan_cache_dir(hub.root)
    assert scan.warnings == []
    [repo] = scan.repos
    assert repo.refs["main"].commit_hash == pushed.oid


def test_the_folder_is_a_genuine_cache(hub: LocalHub, api: HfApi, folder: Path):
    api.create_repo("me/act")
    pushed = api.upload_folder(repo_id="me/act", folder_path=folder)
    api.create_tag("me/act", tag="000002")
    cached = snapshot_download("me/act", revision="000002", cache_dir=hub.root, local_files_only=True)
    assert Path(cached) == hub.root / "models--me--act" / "snapshots" / pushed.oid
    weights = hf_hub_download("me/act", "model.safetensors", cache_dir=hub.root, local_files_only=True)
    assert Path(weights).read_bytes() == (folder / "model.safetensors").read_bytes()
    assert Path(weights).readlink().is_relative_to("../../blobs")


def test_creating_twice_is_fine_with_exist_ok_only(api: HfApi):
    assert api.create_repo("me/act").repo_id == "me/act"
    assert api.create_repo("me/act", exist_ok=True).repo_id == "me/act"
    with pytest.raises(HfHubHTTPError, match="already in the local hub"):
        api.create_repo("me/act")


def test_a_name_without_owner_belongs_to_the_current_user(api: HfApi, folder: Path):
    assert api.create_repo("act_cube").repo_id == f"{owner_name()}/act_cube"
    api.upload_folder(repo_id="act_cube", folder_path=folder)
    assert Path(hf_hub_download("act_cube", "config.json")).read_text() == '{"type": "act"}'


def test_unchanged_files_make_no_revision(api: HfApi, folder: Path):
    api.create_repo("me/act")
    first = api.upload_folder(repo_id="me/act", folder_path=folder)
    assert api.upload_folder(repo_id="me/act", folder_path=folder).oid == first.oid


def test_unchanged_content_is_stored_once(hub: LocalHub, api: HfApi, folder: Path):
    api.create_repo("me/act")
    for step in ("000002", "000004"):
        api.upload_folder(repo_id="me/act", folder_path=folder, path_in_repo=f"checkpoints/{step}")
    assert len(list((hub.root / "models--me--act" / "blobs").iterdir())) == len(FILES)
    assert len(api.list_repo_files("me/act")) == 2 * len(FILES)


def test_history_is_listed_newest_first(api: HfApi, folder: Path):
    api.create_repo("me/act")
    for message in ("one", "two"):
        (folder / "config.json").write_text(message)
        api.upload_folder(repo_id="me/act", folder_path=folder, commit_message=message)
    assert [commit.title for commit in api.list_repo_commits("me/act")] == ["two", "one", "initial commit"]


def test_tags_stay_where_they_are_and_branches_move(api: HfApi, folder: Path):
    api.create_repo("me/act")
    first = api.upload_folder(repo_id="me/act", folder_path=folder)
    api.create_tag("me/act", tag="v1", revision=first.oid)
    api.create_branch("me/act", branch="trials/a")
    (folder / "config.json").write_text("changed")
    second = api.upload_folder(repo_id="me/act", folder_path=folder, revision="trials/a")

    refs = api.list_repo_refs("me/act")
    assert {tag.name: tag.target_commit for tag in refs.tags} == {"v1": first.oid}
    assert {branch.name: branch.target_commit for branch in refs.branches} == {
        "main": first.oid,
        "trials/a": second.oid,
    }
    assert Path(hf_hub_download("me/act", "config.json", revision="trials/a")).read_text() == "changed"
    with pytest.raises(HfHubHTTPError, match="is a tag"):
        api.upload_folder(repo_id="me/act", folder_path=folder / "sub", revision="v1")


def test_tags_and_branches_are_deleted_by_their_own_kind(api: HfApi):
    api.create_repo("me/act")
    api.create_tag("me/act", tag="v1")
    api.create_tag("me/act", tag="v1", exist_ok=True)
    with pytest.raises(HfHubHTTPError, match="already has a tag 'v1'"):
        api.create_tag("me/act", tag="v1")
    with pytest.raises(RevisionNotFoundError):
        api.delete_branch("me/act", branch="v1")
    api.delete_tag("me/act", tag="v1")
    with pytest.raises(RevisionNotFoundError):
        api.delete_tag("me/act", tag="v1")
    with pytest.raises(HfHubHTTPError, match="cannot be deleted"):
        api.delete_branch("me/act", branch="main")
    with pytest.raises(HfHubHTTPError, match="clashes"):
        api.create_branch("me/act", branch="main/sub")


def test_deleting_files_and_folders(api: HfApi, folder: Path):
    api.create_repo("me/act")
    before = api.upload_folder(repo_id="me/act", folder_path=folder)
    api.delete_file("config.json", "me/act")
    api.delete_folder("sub", "me/act")
    assert api.list_repo_files("me/act") == ["README.md", "model.safetensors"]
    assert api.list_repo_files("me/act", revision=before.oid) == FILES
    with pytest.raises(EntryNotFoundError):
        api.delete_file("config.json", "me/act")


def test_copying_a_large_and_a_small_file(api: HfApi, folder: Path):
    api.create_repo("me/act")
    api.upload_folder(repo_id="me/act", folder_path=folder)
    copies = [
        CommitOperationCopy("model.safetensors", "best.safetensors"),
        CommitOperationCopy("config.json", "a/c.json"),
    ]
    api.create_commit("me/act", copies, commit_message="copy")
    best = hf_hub_download("me/act", "best.safetensors")
    assert Path(best).read_bytes() == (folder / "model.safetensors").read_bytes()
    assert Path(hf_hub_download("me/act", "a/c.json")).read_text() == '{"type": "act"}'


def test_a_path_cannot_be_a_file_and_a_folder(api: HfApi, folder: Path):
    api.create_repo("me/act")
    api.upload_folder(repo_id="me/act", folder_path=folder)
    with pytest.raises(BadRequestError, match="cannot be a file and a folder"):
        api.upload_file(path_or_fileobj=b"x", path_in_repo="config.json/x", repo_id="me/act")


def test_a_push_on_an_outdated_parent_is_refused(api: HfApi):
    api.create_repo("me/act")
    first = api.upload_file(path_or_fileobj=b"1", path_in_repo="a", repo_id="me/act")
    api.upload_file(path_or_fileobj=b"2", path_in_repo="a", repo_id="me/act")
    with pytest.raises(HfHubHTTPError, match="somebody pushed in between"):
        api.upload_file(path_or_fileobj=b"3", path_in_repo="a", repo_id="me/act", parent_commit=first.oid)


def test_listing_trees_and_paths(api: HfApi, folder: Path):
    api.create_repo("me/act")
    api.upload_folder(repo_id="me/act", folder_path=folder)
    assert {entry.path for entry in api.list_repo_tree("me/act")} == {
        "README.md",
        "config.json",
        "model.safetensors",
        "sub",
    }
    assert [entry.path for entry in api.list_repo_tree("me/act", "sub")] == FILES[3:]
    recursive = {entry.path for entry in api.list_repo_tree("me/act", recursive=True)}
    assert recursive == {*FILES, "sub"}
    [weights, sub] = api.get_paths_info("me/act", ["model.safetensors", "sub", "nothing"])
    assert (weights.size, sub.path) == (300_000, "sub")
    with pytest.raises(EntryNotFoundError):
        list(api.list_repo_tree("me/act", "nowhere"))


def test_missing_things_raise_the_same_errors_as_the_real_hub(api: HfApi, folder: Path):
    assert not api.repo_exists("me/act")
    with pytest.raises(RepositoryNotFoundError, match="not in the local hub"):
        api.upload_file(path_or_fileobj=b"x", path_in_repo="x", repo_id="me/act")
    api.create_repo("me/act")
    api.upload_folder(repo_id="me/act", folder_path=folder)
    assert not api.file_exists("me/act", "nothing")
    assert not api.revision_exists("me/act", "nothing")
    with pytest.raises(RevisionNotFoundError):
        api.upload_folder(repo_id="me/act", folder_path=folder, revision="nothing")
    with pytest.raises(RevisionNotFoundError, match="branches and tags: main"):
        api.create_tag("me/act", tag="v1", revision="0" * 40)
    with pytest.raises(BadRequestError, match="no pull requests"):
        api.upload_file(path_or_fileobj=b"x", path_in_repo="x", repo_id="me/act", create_pr=True)
    with pytest.raises(HfHubHTTPError, match="has no answer"):
        api.move_repo("me/act", "me/other")


def test_a_branch_that_is_lost_in_its_address_is_refused(hub: LocalHub, api: HfApi):
    api.create_repo("me/act")
    for change in (api.create_branch, api.delete_branch):
        with pytest.raises(HfHubHTTPError, match=r"no branch can be called '\.\.'"):
            change("me/act", branch="..")
    [branch] = api.list_repo_refs("me/act").branches
    assert branch.name == "main"


def test_datasets_and_models_of_one_name_are_apart(hub: LocalHub, api: HfApi):
    api.create_repo("me/cube")
    api.create_repo("me/cube", repo_type="dataset")
    api.upload_file(path_or_fileobj=b"d", path_in_repo="d", repo_id="me/cube", repo_type="dataset")
    assert api.list_repo_files("me/cube") == []
    assert Path(hf_hub_download("me/cube", "d", repo_type="dataset")).read_bytes() == b"d"
    assert sorted(path.name for path in hub.root.iterdir() if path.name != ".locks") == [
        "datasets--me--cube",
        "models--me--cube",
    ]


def test_visibility_follows_the_setting(hub: LocalHub, api: HfApi):
    api.create_repo("me/secret", private=True)
    folder = hub.root / "models--me--secret"
    assert folder.stat().st_mode & 0o777 == 0o700
    assert api.model_info("me/secret").private is True
    api.update_repo_settings("me/secret", private=False)
    assert folder.stat().st_mode & 0o777 == hub.root.stat().st_mode & 0o777
    api.update_repo_settings("me/secret", private=True)
    assert folder.stat().st_mode & 0o077 == 0


def test_deleting_a_repository(hub: LocalHub, api: HfApi):
    api.create_repo("me/act")
    api.delete_repo("me/act")
    assert not (hub.root / "models--me--act").exists()
    api.delete_repo("me/act", missing_ok=True)
    with pytest.raises(RepositoryNotFoundError):
        api.delete_repo("me/act")


def test_a_download_resumes_where_it_stopped(api: HfApi, folder: Path):
    api.create_repo("me/act")
    api.upload_folder(repo_id="me/act", folder_path=folder)
    address = "https://huggingface.co/me/act/resolve/main/model.safetensors"
    content = (folder / "model.safetensors").read_bytes()
    part = get_session().get(address, headers={"Range": "bytes=299990-"})
    assert (part.status_code, part.content) == (206, content[299990:])
    assert part.headers["Content-Range"] == "bytes 299990-299999/300000"
    middle = get_session().get(address, headers={"Range": "bytes=7-9"})
    assert middle.content == content[7:10]
    assert get_session().get(address, headers={"Range": "bytes=300000-"}).status_code == 416


@full_tier  # its workers poll every ten seconds
def test_a_large_folder_pushes_too(api: HfApi, folder: Path):
    api.create_repo("me/act")
    with pytest.warns(FutureWarning, match="upload_large_folder"):  # LeRobotDataset.push_to_hub may use it
        api.upload_large_folder("me/act", folder, repo_type="model", num_workers=2, print_report=False)
    assert api.list_repo_files("me/act") == FILES


def test_the_file_system_interface_reads_parts_of_files(api: HfApi, folder: Path):
    api.create_repo("me/act")
    api.upload_folder(repo_id="me/act", folder_path=folder)
    system = HfFileSystem(skip_instance_cache=True)
    assert sorted(system.glob("me/act/**/*.safetensors")) == [
        f"me/act/{name}" for name in FILES if "safetensors" in name
    ]
    with system.open("me/act/model.safetensors", "rb") as file:
        file.seek(299_000)
        assert file.read(100) == (folder / "model.safetensors").read_bytes()[299_000:299_100]


def test_cards_are_validated_without_the_real_hub(api: HfApi):
    ModelCard("---\nlicense: mit\n---\ntext").validate()
    api.create_repo("me/act")
    for metadata, complaint in (("- a\n- list", "not a mapping"), ("a: [", "not YAML")):
        card = CommitOperationAdd("README.md", f"---\n{metadata}\n---\n".encode())
        with pytest.raises(ValueError, match=complaint):
            api.create_commit("me/act", [card], commit_message="card")


def test_every_push_says_where_the_files_are(
    hub: LocalHub, api: HfApi, folder: Path, caplog: pytest.LogCaptureFixture
):
    api.create_repo("me/act")
    with caplog.at_level(logging.INFO, logger="lerobot_act_chunking.hub"):
        pushed = api.upload_folder(repo_id="me/act", folder_path=folder)
    [line] = [record.getMessage() for record in caplog.records if "is now" in record.getMessage()]
    assert str(hub.root / "models--me--act" / "snapshots" / pushed.oid) in line
    assert "me/act@main" in line
    assert "not contacted" in line


class Recorder(httpx.BaseTransport):
    """Stands for the real Hub: remembers what it is asked."""

    def __init__(self):
        self.asked: list[str] = []

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        self.asked.append(f"{request.method} {request.url.path}")
        return httpx.Response(200, json={"from": "the real Hub"})


def answer(transport: LocalHubTransport, method: str, path: str, **kwargs: object) -> httpx.Response:
    with httpx.Client(transport=transport) as client:
        return client.request(method, f"https://huggingface.co{path}", **kwargs)


def test_nothing_falls_through_unless_told_to(hub: LocalHub):
    real = Recorder()
    response = answer(LocalHubTransport(hub, outside=real), "GET", "/api/models/me/act")
    assert (response.status_code, response.headers["X-Error-Code"]) == (404, "RepoNotFound")
    assert real.asked == []


@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("GET", "/api/models/me/other"),
        ("HEAD", "/me/other/resolve/main/config.json"),
        ("POST", "/api/datasets/me/other/paths-info/main"),
        ("GET", "/api/models"),
    ],
)
def test_reading_what_is_not_here_falls_through_when_told_to(hub: LocalHub, method: str, path: str):
    real = Recorder()
    assert answer(LocalHubTransport(hub, fall_through=True, outside=real), method, path).status_code == 200
    assert real.asked == [f"{method} {path}"]


def test_what_is_here_and_every_write_stay_here(hub: LocalHub, api: HfApi):
    api.create_repo("me/act")
    real = Recorder()
    transport = LocalHubTransport(hub, fall_through=True, outside=real)
    assert answer(transport, "GET", "/api/models/me/act").json()["id"] == "me/act"
    assert answer(transport, "GET", "/me/act/resolve/main/nothing").status_code == 404
    body = json.dumps({"key": "header", "value": {}}).encode()
    assert answer(transport, "POST", "/api/models/me/other/commit/main", content=body).status_code == 404
    assert answer(transport, "DELETE", "/api/repos/delete", json={"name": "other"}).status_code == 404
    assert real.asked == []


def test_offline_mode_blocks_the_outside_but_not_the_folder(
    hub: LocalHub, api: HfApi, folder: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    api.create_repo("me/act")
    api.upload_folder(repo_id="me/act", folder_path=folder)
    assert Path(snapshot_download("me/act")).is_dir()
    transport = LocalHubTransport(hub, fall_through=True)
    with pytest.raises(OfflineModeIsEnabled):
        answer(transport, "GET", "/api/models/me/other")
    with httpx.Client(transport=transport) as client, pytest.raises(OfflineModeIsEnabled):
        client.get("https://example.com/")
