"""Whatever a push may store can be loaded: names drawn at random, through huggingface_hub's client."""

import os
import random
from pathlib import Path

import pytest
from huggingface_hub import CommitOperationAdd, HfApi, hf_hub_download, snapshot_download
from huggingface_hub.errors import HfHubHTTPError
from test_hub_damage import command
from tiers import draws

from lerobot_act_chunking.errors import ActChunkingError
from lerobot_act_chunking.hub.names import ADDRESS_WORDS, KINDS, RepoName
from lerobot_act_chunking.hub.refusal import RefusedError
from lerobot_act_chunking.hub.storage import LocalHub
from lerobot_act_chunking.hub.transport import ACTIONS
from lerobot_act_chunking.hub.verifying import verify

WORDS = [
    *sorted(ADDRESS_WORDS),
    "main",
    "HEAD",
    "heads",
    "me",
    "act",
    "a",
    "a.b",
    "_",
    "0",
    "x" * 96,
    "model",
]
ODD = [
    "a b", "a+b", "50%", "%2F", "%2e%2e", "a?b", "a#b", "a&b=c", "é", "é", "名", "a;b", "a:b", "ab:c", "@",
    "a@{b", '"', "~", "$x", "a*", "[a]", "{a}", "<a>", "|", "^", "`", "-", "--", "-a", ".a", "a.", "a.git",
    "a.lock", ".git", ".cache", "..", "...", "a\\b", "a\nb", "a\x00", "\udcff", "😀", "1" * 7, "abcdef0",
    "0" * 40, "A" * 40, "e" * 64, "n" * 240, "n" * 241, "n" * 255, "n" * 256, "/".join(["d"] * 60),
    "/".join(["d"] * 600), "refs/pr/1", "",
]  # fmt: skip


def part(rng: random.Random) -> str:
    """One name: a word of the Hub's addresses, something odd, or random characters."""
    alphabet = "abcXYZ019-_." + rng.choice(["", "/", " %?#:&+=é~@"])
    random_name = "".join(rng.choice(alphabet) for _ in range(rng.randint(1, 12)))
    return rng.choice([rng.choice(WORDS), rng.choice(ODD), random_name])


def path(rng: random.Random, longest: int) -> str:
    return "/".join(part(rng) for _ in range(rng.randint(1, longest)))


def refused(action):
    """The action's result, or None if the client or the hub refused it; anything else is a failure."""
    try:
        return action()
    except (HfHubHTTPError, ValueError) as error:
        reason = str(error)
    assert "has no answer" not in reason
    return None


def assert_loads(repo_id: str, kind: str, revision: str, files: dict[str, bytes], target: Path) -> None:
    """Both ways to download, into a cache and into a folder."""
    about = {"repo_id": repo_id, "repo_type": kind, "revision": revision}
    folder = Path(snapshot_download(**about, cache_dir=target / "cache"))
    flat = Path(snapshot_download(**about, local_dir=target / "flat"))
    for name, content in files.items():
        one = hf_hub_download(**about, filename=name, cache_dir=target / "other")
        for loaded in (folder / name, flat / name, Path(one)):
            assert loaded.read_bytes() == content


@pytest.mark.parametrize("seed", range(draws(10, 500)))
def test_what_is_accepted_can_be_loaded(
    hub: LocalHub, api: HfApi, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int
):
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)
    rng = random.Random(seed)
    kind, given = rng.choice(KINDS), "/".join(part(rng) for _ in range(rng.randint(1, 2)))
    about = {"repo_type": kind, "space_sdk": "static" if kind == "space" else None}
    if refused(lambda: api.create_repo(given, **about)) is None:
        assert hub.names() == []
        given = rng.choice(["me/act", "act"])
        api.create_repo(given, **about)
    [name] = hub.names()
    files = {}
    for number in range(rng.randint(1, 4)):
        file, content = path(rng, 3), rng.randbytes(rng.choice([0, 10, 70_000]))
        pushed = refused(
            lambda file=file, content=content, number=number: api.create_commit(
                given,
                [CommitOperationAdd(file, content)],
                commit_message=part(rng) or "files",
                repo_type=kind,
            )
        )
        if pushed is not None:
            files[CommitOperationAdd(file, b"").path_in_repo] = content
    revisions = ["main", hub.open(name).head("main"), hub.open(name).head("main")[:12]]
    for create in (api.create_branch, api.create_tag):
        ref = path(rng, 2)
        key = "branch" if create == api.create_branch else "tag"
        if refused(
            lambda create=create, key=key, ref=ref: create(given, **{key: ref}, repo_type=kind) or ref
        ):
            revisions.append(ref)

    for number, revision in enumerate(revisions):
        assert_loads(name.repo_id, kind, revision, files, tmp_path / f"full-{number}")
    assert_loads(given, kind, revisions[-1], files, tmp_path / "given")
    assert sorted(api.list_repo_files(given, repo_type=kind)) == sorted(files)
    assert len(api.list_repo_commits(given, repo_type=kind)) == len(hub.open(name).revisions())
    listed = api.list_repo_refs(given, repo_type=kind)
    assert {ref.name for ref in listed.branches + listed.tags} == {"main", *revisions[3:]}
    assert verify(hub.open(name)).problems == []
    assert command(hub, "show", name.repo_id, "--type", kind)[0] == 0


def test_every_word_of_an_address_is_reserved():
    assert ACTIONS - {""} <= ADDRESS_WORDS


@pytest.mark.parametrize("repo_id", ["api/x", "datasets/x", "me/models", "resolve/x", "me.git/x"])
def test_a_name_that_no_address_can_tell_is_refused_with_the_rule(hub: LocalHub, repo_id: str):
    with pytest.raises(RefusedError, match="choose another name"):
        hub.create(RepoName.checked("model", repo_id))
    assert hub.names() == []


@pytest.mark.parametrize("digits", [7, 12, 39])
def test_the_first_digits_of_an_id_name_a_revision_everywhere(hub: LocalHub, api: HfApi, digits: int):
    api.create_repo("me/act")
    first = api.upload_file(path_or_fileobj=b"1", path_in_repo="a", repo_id="me/act").oid
    api.upload_file(path_or_fileobj=b"2", path_in_repo="a", repo_id="me/act")
    short = first[:digits]
    assert Path(hf_hub_download("me/act", "a", revision=short)).read_bytes() == b"1"
    assert Path(snapshot_download("me/act", revision=short)).name == first
    api.create_tag("me/act", tag="v1", revision=short)
    assert hub.open(RepoName("model", "me/act")).head("v1") == first
    assert command(hub, "show", "me/act", "--revision", short)[0] == 0
    assert "still named by v1" in command(hub, "delete", "me/act", "--revision", short)[1][0]
    command(hub, "delete", "me/act", "--revision", "v1")
    assert not hub.open(RepoName("model", "me/act")).has_revision(first)


def test_a_short_id_is_refused_where_it_is_ambiguous_and_yields_to_a_name(hub: LocalHub, api: HfApi):
    repository = hub.create(RepoName("model", "me/act"))
    for end in "12":
        (repository.snapshots / f"{'a' * 39}{end}").mkdir()
    with pytest.raises(RefusedError, match=r"a1, a+2"):
        repository.resolve("a" * 12)
    api.create_tag("me/act", tag="a" * 12)
    assert repository.resolve("a" * 12) == repository.resolve("main")
    (repository.ref_folder / ("a" * 12)).write_text("garbage")
    with pytest.raises(ActChunkingError, match="has no revision"):
        repository.resolve("a" * 12)


def test_a_name_is_free_again_when_the_names_below_it_are_gone(hub: LocalHub, api: HfApi):
    api.create_repo("me/act")
    api.create_tag("me/act", tag="a/b")
    api.delete_tag("me/act", tag="a/b")
    api.create_branch("me/act", branch="a")
    assert hub.open(RepoName("model", "me/act")).tags() == set()
