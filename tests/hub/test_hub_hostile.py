"""Names, paths and requests made to break out of the folder or to store something wrong: all refused."""

import base64
import json
import os
import string
from pathlib import Path

import httpx
import pytest
from huggingface_hub import HfApi
from huggingface_hub.errors import HfHubHTTPError
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lerobot_act_chunking.hub import verifying
from lerobot_act_chunking.hub.commits import Commit, Entry
from lerobot_act_chunking.hub.names import KINDS, RepoName, checked_path, checked_ref
from lerobot_act_chunking.hub.refusal import RefusedError
from lerobot_act_chunking.hub.storage import LocalHub
from lerobot_act_chunking.hub.transport import LocalHubTransport

ADDRESS = "https://huggingface.co"
LONG = "a" * 100_000
CONTENT = "what nobody may read"
UGLY = st.one_of(
    st.sampled_from(
        ["..", ".", "", "/", "//", "\x00", "%2e%2e", "%00", "~", "\\", "C:", ".git", "\udcff", "--"]
    ),
    st.just(3_000).map(lambda length: "a" * length),  # more only slows hypothesis; LONG itself is tried above
)
PLAUSIBLE = r"[A-Za-z0-9][\w.\-]{0,9}(/[A-Za-z0-9][\w.\-]{0,9})?"
NASTY_NAMES = st.lists(st.one_of(UGLY, st.text(max_size=8)), min_size=1, max_size=5).map("/".join)


@pytest.mark.parametrize(
    "repo_id",
    [
        "",
        "..",
        ".",
        "../x",
        "x/..",
        "/etc",
        "a/b/c",
        "a//b",
        "a\x00b",
        "a b",
        "me/x--y",
        LONG,
        "é",
        "me/x.git",
        None,
        7,
    ],
)
def test_repository_ids_that_leave_the_folder_are_refused(repo_id: object):
    with pytest.raises(RefusedError) as refusal:
        RepoName.checked("model", repo_id)
    assert len(str(refusal.value)) < 200_000


@pytest.mark.parametrize(
    "path",
    ["", "/etc/passwd", "../x", "a/../../x", "a/..", "./a", "a//b", "a/", "a\x00", "a\nb", "a\\b", ".git/x",
     LONG, "/".join(["deep"] * 300), "\udcff", "e" * 256, None],
)  # fmt: skip
def test_paths_that_leave_the_repository_are_refused(path: object):
    with pytest.raises(RefusedError):
        checked_path(path)


@pytest.mark.parametrize(
    "ref",
    ["", "..", "../main", "a/../b", "/main", "main/", "a//b", ".hidden", "a/.b", "x.lock", "a b", "a\x00",
     "a~1", "a^", "a:b", "a?", "a*", "a[", "a\\b", "@{1}", "0" * 40, LONG, None],
)  # fmt: skip
def test_revisions_that_are_no_branch_or_tag_names_are_refused(ref: object):
    with pytest.raises(RefusedError):
        checked_ref(ref)


@settings(deadline=None)
@given(NASTY_NAMES)
def test_an_accepted_name_stays_below_its_folder(name: str):
    for check, base in ((checked_path, "/hub/snapshot"), (checked_ref, "/hub/refs")):
        try:
            checked = check(name)
        except RefusedError:
            continue
        joined = os.path.normpath(f"{base}/{checked}")
        assert joined.startswith(f"{base}/")
        assert Path(joined).relative_to(base).as_posix() == checked


@given(
    st.sampled_from(KINDS),
    st.from_regex(r"[A-Za-z0-9][\w.\-]{0,9}(/[A-Za-z0-9][\w.\-]{0,9})?", fullmatch=True),
)
def test_an_accepted_repository_is_one_folder_that_names_it_back(kind: str, repo_id: str):
    try:
        name = RepoName.checked(kind, repo_id)
    except RefusedError:
        return
    assert "/" not in name.folder
    assert RepoName.from_folder(name.folder) == name


@pytest.fixture
def filled(hub: LocalHub, api: HfApi, folder: Path) -> LocalHub:
    """A hub with one repository, beside a file that nobody may reach."""
    api.create_repo("me/act")
    api.upload_folder(repo_id="me/act", folder_path=folder)
    (hub.root.parent / "secret").write_text(CONTENT)
    return hub


def tree_below(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*")}


def ask(hub: LocalHub, method: str, raw_path: bytes, content: bytes = b"") -> httpx.Response:
    """One request with its path exactly as given: httpx would tidy up ``..``."""
    url = httpx.URL(scheme="https", host="huggingface.co", raw_path=b"/" + raw_path.lstrip(b"/"))
    request = httpx.Request(method, url, content=content)
    response = LocalHubTransport(hub).handle_request(request)
    response.read()
    return response


RAW = st.one_of(
    st.binary(max_size=30),
    st.sampled_from(
        [b"..", b"%2e%2e", b"%2e%2e%2fsecret", b"%00", b"%ff", b".git", b"lfs", b"main", b"me", b"act"]
    ),
    st.sampled_from(
        [b"api", b"models", b"datasets", b"tree", b"resolve", b"commit", b"revision", b"info", b"tag"]
    ),
)
BODIES = st.one_of(
    st.binary(max_size=60),
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.text(max_size=6) | NASTY_NAMES,
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(
                st.sampled_from(
                    ["name", "organization", "type", "files", "objects", "path", "size", "oid", "tag", "key"]
                ),
                inner,
                max_size=4,
            )
        ),
        max_leaves=8,
    ).map(lambda value: json.dumps(value).encode()),
)


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.sampled_from(["GET", "HEAD", "POST", "PUT", "DELETE", "PATCH"]),
    st.lists(RAW, min_size=1, max_size=8).map(b"/".join),
    BODIES,
)
def test_no_request_reaches_outside_or_crashes(filled: LocalHub, method: str, path: bytes, body: bytes):
    path = bytes(byte for byte in path if 32 < byte < 127 and byte not in b"?#")
    response = ask(filled, method, path, body)
    assert response.status_code < 500
    assert CONTENT.encode() not in response.content
    assert tree_below(filled.root.parent) >= {"secret", "hub"}
    assert {path.name for path in filled.root.parent.iterdir()} <= {
        "secret",
        "hub",
        "source",
        "downloads",
        "token",
    }


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.sampled_from(["file", "lfsFile", "deletedFile", "deletedFolder", "header", "other"]),
    st.dictionaries(
        st.sampled_from(["path", "content", "oid", "size", "summary", "parentCommit", "encoding"]),
        st.one_of(NASTY_NAMES, st.integers(), st.none(), st.just(base64.b64encode(b"x").decode())),
    ),
)
def test_no_commit_writes_outside(filled: LocalHub, key: str, value: dict[str, object]):
    line = json.dumps({"key": key, "value": value}).encode()
    response = ask(filled, "POST", b"api/models/me/act/commit/main", line)
    assert response.status_code < 500
    assert (filled.root.parent / "secret").read_text() == CONTENT
    assert verifying.verify(filled.open(RepoName("model", "me/act"))).problems == []


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(max_size=40), st.text(string.hexdigits, max_size=70), st.integers(-2, 10**20))
def test_an_upload_with_a_wrong_checksum_or_length_stores_nothing(
    filled: LocalHub, body: bytes, oid: str, size: int
):
    blobs = filled.root / "models--me--act" / "blobs"
    before = tree_below(blobs)
    response = ask(filled, "PUT", f"me/act.git/lfs/{oid}?size={size}".encode(), body)
    assert response.status_code == 400
    assert tree_below(blobs) == before
    assert tree_below(filled.root / "models--me--act" / ".hub" / "incoming") == set()


@pytest.mark.parametrize("claim", ["shorter", "longer", "other content"])
def test_an_upload_must_be_what_it_announced(filled: LocalHub, claim: str):
    import hashlib

    body = b"weights" * 100
    digest = hashlib.sha256(body).hexdigest()
    size = len(body) + {"shorter": -1, "longer": 1, "other content": 0}[claim]
    sent = body[::-1] if claim == "other content" else body
    response = ask(filled, "PUT", f"me/act.git/lfs/{digest}?size={size}".encode(), sent)
    assert response.status_code == 400
    assert "nothing was stored" in response.json()["error"]
    assert not (filled.root / "models--me--act" / "blobs" / digest).exists()


@pytest.mark.parametrize("content", ["\x80", "not base64!", "eA=", None, 3])
def test_content_that_is_not_base64_is_refused(filled: LocalHub, content: object):
    line = json.dumps({"key": "file", "value": {"path": "x", "content": content}}).encode()
    assert ask(filled, "POST", b"api/models/me/act/commit/main", line).status_code == 400


def test_a_commit_cannot_name_content_that_was_never_uploaded(filled: LocalHub):
    value = {"path": "x", "algo": "sha256", "oid": "0" * 64, "size": 5}
    line = json.dumps({"key": "lfsFile", "value": value}).encode()
    response = ask(filled, "POST", b"api/models/me/act/commit/main", line)
    assert response.status_code == 400
    assert "push again" in response.json()["error"]


@pytest.mark.parametrize(
    "part", ["", "blobs", "snapshots", "refs", ".hub/incoming", ".hub/commits", ".hub/tags"]
)
def test_a_folder_that_is_a_symlink_out_of_the_hub_is_refused(filled: LocalHub, tmp_path: Path, part: str):
    outside = tmp_path / "outside"
    inside = filled.root / "models--me--act" / part
    inside.rename(outside)
    inside.symlink_to(outside)
    before = tree_below(outside)
    with pytest.raises(HfHubHTTPError, match="leads out of"):
        HfApi().upload_file(path_or_fileobj=b"x", path_in_repo="x", repo_id="me/act")
    assert tree_below(outside) == before


def test_symlinked_files_and_refs_that_leave_are_not_served(filled: LocalHub):
    repository = filled.open(RepoName("model", "me/act"))
    head = repository.resolve("main")
    shown = repository.snapshots / head / "config.json"
    shown.unlink()
    shown.symlink_to(filled.root.parent / "secret")
    (repository.ref_folder / "leak").symlink_to(filled.root.parent / "secret")

    response = ask(filled, "GET", b"me/act/resolve/main/config.json")
    assert response.status_code == 403
    assert b"through a symlink" in response.content
    assert ask(filled, "GET", b"api/models/me/act/revision/leak").status_code == 404
    assert "leak" not in repository.refs()
    assert any("leads out" in problem for problem in verifying.verify(repository).problems)


def test_a_ref_folder_that_is_a_symlink_cannot_be_written_through(filled: LocalHub, tmp_path: Path):
    outside = tmp_path / "outside"
    outside.mkdir()
    (filled.root / "models--me--act" / "refs" / "trials").symlink_to(outside)
    with pytest.raises(HfHubHTTPError, match="leads out of"):
        HfApi().create_branch("me/act", branch="trials/a")
    assert list(outside.iterdir()) == []


def forge(filled: LocalHub, path: str, entry: Entry, date: str = "2026-01-01T00:00:00+00:00") -> None:
    """Point ``main`` at a revision whose description is consistent with its id, and hostile."""
    repository = filled.open(RepoName("model", "me/act"))
    commit = Commit("title", "", "mallory", date, None, "", {path: entry})
    (repository.commit_folder / f"{commit.commit_id}.json").write_bytes(commit.to_json())
    (repository.snapshots / commit.commit_id).mkdir()
    (repository.ref_folder / "main").write_text(commit.commit_id)


@pytest.mark.parametrize(
    ("path", "digest", "date"),
    [
        ("../../../../escaped", "0" * 64, "2026-01-01"),
        ("x", "../../../secret", "2026-01-01"),
        ("x", "0" * 64, "yesterday"),
    ],
)
def test_a_forged_description_cannot_write_or_link_outside(
    filled: LocalHub, path: str, digest: str, date: str
):
    before = tree_below(filled.root.parent)
    forge(filled, path, Entry(digest, 6), date)
    line = json.dumps({"key": "file", "value": {"path": "new", "content": "eA=="}}).encode()
    response = ask(filled, "POST", b"api/models/me/act/commit/main", line)
    assert response.status_code == 422
    assert "is damaged" in response.json()["error"]
    added = tree_below(filled.root.parent) - before
    assert all(name.startswith("hub/models--me--act/") for name in added)


def test_a_damaged_description_is_not_believed(filled: LocalHub):
    repository = filled.open(RepoName("model", "me/act"))
    head = repository.resolve("main")
    description = repository.commit_folder / f"{head}.json"
    for damage in (
        description.read_bytes().replace(b"config.json", b"../x"),
        b"[]",
        b"\xff",
        b'{"files": 3}',
    ):
        description.write_bytes(damage)
        response = ask(filled, "GET", b"api/models/me/act")
        assert response.status_code == 422
        assert "is damaged" in response.json()["error"]
