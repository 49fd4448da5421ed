"""The folder itself: layout, privacy, file systems without links, failures in the middle, full disks."""

import errno
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from checkpoint_files import FILES
from huggingface_hub import HfApi, scan_cache_dir, snapshot_download
from huggingface_hub.errors import HfHubHTTPError

from lerobot_act_chunking.hub import storage
from lerobot_act_chunking.hub.names import RepoName
from lerobot_act_chunking.hub.refusal import RefusedError
from lerobot_act_chunking.hub.storage import LocalHub
from lerobot_act_chunking.hub.verifying import verify

MODEL = RepoName("model", "me/act")


def tree_of(root: Path) -> dict[str, bytes]:
    return {
        path.relative_to(root).as_posix(): path.read_bytes() for path in root.rglob("*") if path.is_file()
    }


def test_names_lists_repositories_and_ignores_everything_else(hub: LocalHub, api: HfApi):
    assert hub.names() == []
    api.create_repo("me/b")
    api.create_repo("me/a", repo_type="dataset")
    (hub.root / "models--not--a--repository").mkdir()
    (hub.root / "notes.txt").touch()
    assert hub.names() == [RepoName("dataset", "me/a"), RepoName("model", "me/b")]


def test_a_waiting_writer_gives_up_with_the_lock_s_name(hub: LocalHub, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(storage, "LOCK_TIMEOUT", 0.01)
    with hub.lock(MODEL), pytest.raises(RefusedError, match=r"models--me--act\.lock"), hub.lock(MODEL):
        pass


def as_nobody(code: str) -> str:
    """Run code as another user; what it prints."""
    command = [sys.executable, "-c", f"import os; os.setgid(65534); os.setuid(65534); {code}"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


@pytest.mark.skipif(os.name == "nt" or os.getuid() != 0, reason="needs root to become another user")
def test_another_user_can_read_public_repositories_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for parent in (tmp_path, *tmp_path.parents):
        if parent.stat().st_uid == os.getuid() and "pytest" in str(parent):
            parent.chmod(0o755)
    hub = LocalHub(tmp_path / "hub")
    hub.create(MODEL)
    hub.create(RepoName("model", "me/secret"), private=True)
    readable = f"print([name for name in sorted(os.listdir({str(hub.root)!r})) "
    readable += f"if name[0] != '.' and os.access({str(hub.root)!r} + '/' + name, os.R_OK | os.X_OK)])"
    assert as_nobody(readable) == "['models--me--act']"
    # What is created inside stays behind the same door.
    inner = hub.root / "models--me--secret" / "refs" / "main"
    assert as_nobody(f"print(os.path.exists({str(inner)!r}))") == "False"


def test_a_file_system_that_cannot_hide_is_not_called_private(hub: LocalHub, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(Path, "chmod", lambda self, mode: None)
    with pytest.raises(RefusedError, match="cannot keep a repository private"):
        hub.create(MODEL, private=True)
    assert hub.names() == []


def refuse_links(monkeypatch: pytest.MonkeyPatch, *kinds: str) -> None:
    def refuse(self: Path, target: object, *_: object) -> None:
        raise OSError(errno.EPERM, "no links here")

    for kind in kinds:
        monkeypatch.setattr(Path, kind, refuse)


@pytest.mark.parametrize("missing", [("symlink_to",), ("symlink_to", "hardlink_to")])
def test_without_symlinks_everything_still_works(
    hub: LocalHub, api: HfApi, folder: Path, monkeypatch: pytest.MonkeyPatch, missing: tuple[str, ...]
):
    refuse_links(monkeypatch, *missing)
    api.create_repo("me/act")
    api.upload_folder(repo_id="me/act", folder_path=folder)
    (folder / "config.json").write_text("changed")
    api.upload_folder(repo_id="me/act", folder_path=folder)
    api.create_tag("me/act", tag="v1")

    assert not any(path.is_symlink() for path in hub.root.rglob("*"))
    assert verify(hub.open(MODEL)).problems == []
    assert scan_cache_dir(hub.root).warnings == []
    offline = Path(snapshot_download("me/act", revision="v1", cache_dir=hub.root, local_files_only=True))
    for name in FILES:
        assert (offline / name).read_bytes() == (folder / name).read_bytes()


def test_a_cache_that_huggingface_hub_filled_is_a_hub(
    hub: LocalHub, api: HfApi, folder: Path, tmp_path: Path
):
    """Downloads copied to an offline machine: read them, verify them, push on top of them."""
    api.create_repo("me/act")
    api.upload_folder(repo_id="me/act", folder_path=folder)
    snapshot_download("me/act", cache_dir=tmp_path / "cache")
    shutil.rmtree(hub.root)
    (tmp_path / "cache").rename(hub.root)

    assert api.list_repo_files("me/act") == FILES
    assert verify(hub.open(MODEL)).problems == []
    api.upload_file(path_or_fileobj=b"new", path_in_repo="new.txt", repo_id="me/act")
    assert api.list_repo_files("me/act") == sorted([*FILES, "new.txt"])
    assert verify(hub.open(MODEL)).problems == []
    assert scan_cache_dir(hub.root).warnings == []


def failing_at(monkeypatch: pytest.MonkeyPatch, step: int) -> Callable[[], int]:
    """Make the step-th rename die as a power cut would; returns how many renames were tried."""
    count = 0
    rename = Path.replace

    def replace(self: Path, target: Path) -> Path:
        nonlocal count
        count += 1
        if count == step:
            raise KeyboardInterrupt
        return rename(self, target)

    monkeypatch.setattr(Path, "replace", replace)
    return lambda: count


def test_stopping_a_push_before_any_rename_leaves_the_previous_revision(
    hub: LocalHub, api: HfApi, folder: Path, monkeypatch: pytest.MonkeyPatch
):
    api.create_repo("me/act")
    before = api.upload_folder(repo_id="me/act", folder_path=folder).oid
    shown = tree_of(hub.root / "models--me--act" / "snapshots" / before)
    step = 0
    while True:
        step += 1
        (folder / "model.safetensors").write_bytes(os.urandom(100_000))
        with monkeypatch.context() as patch:
            tried = failing_at(patch, step)
            try:
                after = api.upload_folder(repo_id="me/act", folder_path=folder).oid
            except (KeyboardInterrupt, RuntimeError):  # huggingface_hub wraps what stops an upload
                pass
            else:
                assert tried() < step
                break
        assert hub.open(MODEL).resolve("main") == before
        assert tree_of(hub.root / "models--me--act" / "snapshots" / before) == shown
        assert verify(hub.open(MODEL)).problems == []
        assert scan_cache_dir(hub.root).warnings == []
    assert step >= 5  # blob, description, snapshot, ref; some huggingface_hub rename files of their own, too
    assert hub.open(MODEL).resolve("main") == after


def test_a_full_disk_publishes_nothing_and_says_so(
    hub: LocalHub, api: HfApi, folder: Path, monkeypatch: pytest.MonkeyPatch
):
    api.create_repo("me/act")
    api.upload_folder(repo_id="me/act", folder_path=folder)
    before = tree_of(hub.root / "models--me--act")
    real = os.fsync

    # Forced to disk, in order: blob, its folder, both folders of the snapshot, description, its folder, the
    # folder of snapshots, the ref. (After the ref's rename only its folder is left: the push has landed.)
    for survived in range(8):
        (folder / "model.safetensors").write_bytes(os.urandom(100_000))
        left = survived

        def fsync(descriptor: int) -> None:
            nonlocal left
            left -= 1
            if left < 0:
                raise OSError(errno.ENOSPC, "No space left on device")
            real(descriptor)

        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", fsync)
            with pytest.raises((HfHubHTTPError, RuntimeError)) as failure:
                api.upload_folder(repo_id="me/act", folder_path=folder)
        message = str(failure.value.__cause__ or failure.value) + str(failure.value)
        assert "no space left for the local hub" in message
        assert "earlier revisions are safe" in message
        after = tree_of(hub.root / "models--me--act")
        assert {path: after.get(path) for path in before} == before
        assert not list((hub.root / "models--me--act" / ".hub" / "incoming").iterdir())
    api.upload_folder(repo_id="me/act", folder_path=folder)
    assert verify(hub.open(MODEL)).problems == []


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of four megabytes."""
    mount = tmp_path / "disk"
    mount.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=4m", "tmpfs", str(mount)]
    try:
        subprocess.run(command, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"cannot mount a small file system: {error}")
    yield mount
    subprocess.run(["umount", str(mount)], check=True)


def test_a_really_full_disk(small_disk: Path, api: HfApi, tmp_path: Path):
    from lerobot_act_chunking.hub.routing import route_to

    hub = LocalHub(small_disk / "hub")
    route_to(hub)
    api.create_repo("me/act")
    first = os.urandom(1_500_000)
    pushed = api.upload_file(path_or_fileobj=first, path_in_repo="model.safetensors", repo_id="me/act").oid
    with pytest.raises(RuntimeError) as failure:
        api.upload_file(
            path_or_fileobj=os.urandom(3_500_000), path_in_repo="model.safetensors", repo_id="me/act"
        )
    assert "no space left for the local hub" in str(failure.value.__cause__)

    repository = hub.open(MODEL)
    assert repository.resolve("main") == pushed
    assert repository.file(pushed, "model.safetensors").read_bytes() == first
    report = verify(repository)
    assert (report.problems, report.unreferenced) == ([], 0)
    api.upload_file(path_or_fileobj=os.urandom(1_500_000), path_in_repo="model.safetensors", repo_id="me/act")
    assert verify(repository).problems == []


def test_deleting_sweeps_what_killed_deletions_left(hub: LocalHub):
    hub.create(MODEL)
    trash = hub.root / ".locks" / "lerobot-hub" / "0123456789abcdef"
    trash.mkdir()
    os.utime(trash, (0, 0))
    hub.delete(MODEL)
    assert [path.name for path in trash.parent.iterdir()] in ([], ["models--me--act.lock"])
