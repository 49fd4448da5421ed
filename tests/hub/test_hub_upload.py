"""The model card's section, publishing to another hub, and the command line."""

import os
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import pytest
from huggingface_hub import HfApi, ModelCard, snapshot_download
from typer.testing import CliRunner

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.cli.hub import app
from lerobot_act_chunking.diagnostics.core.report import EXIT_CODES
from lerobot_act_chunking.errors import ActChunkingError
from lerobot_act_chunking.hub import routing
from lerobot_act_chunking.hub.card import extend_card, policy_section
from lerobot_act_chunking.hub.names import RepoName
from lerobot_act_chunking.hub.storage import LocalHub
from lerobot_act_chunking.hub.upload import publish

MODEL = RepoName("model", "me/act")


def feature(kind: str, *shape: int) -> SimpleNamespace:
    return SimpleNamespace(type=SimpleNamespace(value=kind), shape=list(shape))


@dataclass
class Settings:
    type: str = "act_chunked"
    repo_id: str | None = "me/act"
    execution_settings: ExecutionSettings = field(
        default_factory=lambda: ExecutionSettings(100, n_action_steps=50)
    )
    input_features: dict = field(
        default_factory=lambda: {"observation.images.top": feature("VISUAL", 3, 48, 64)}
    )
    output_features: dict = field(default_factory=lambda: {"action": feature("ACTION", 14)})


def test_the_card_tells_shapes_execution_and_commands():
    section = policy_section(
        Settings(), command=["/usr/bin/lerobot-train", "--policy.repo_id=me/act", "--job_name=a b"], fps=50
    )
    assert "| `observation.images.top` | VISUAL | (3, 48, 64) |" in section
    assert "| `action` | ACTION | (14,) |" in section
    assert "a chunk that covers 100 control steps (2.00 s at 50 Hz)" in section
    assert "asked for every 50 steps (1.00 s at 50 Hz); the first 50 actions" in section
    assert "each chunk is executed to its end" in section
    assert "temporal_ensemble_coeff" not in section
    assert "\nlerobot-train --policy.repo_id=me/act '--job_name=a b'\n" in section
    assert "LEROBOT_LOCAL_HUB=/path/to/hub lerobot-eval --policy.path=me/act" in section


def test_the_card_explains_ensembling_and_copes_without_a_frame_rate():
    execution = ExecutionSettings(100, "ensemble", replan_interval=1, latency_steps=2, smoothing_steps=5)
    section = policy_section(Settings(repo_id=None, execution_settings=execution), command=[])
    assert "the weighted mean of all chunks" in section
    assert "`ensemble_weighting=act`, `temporal_ensemble_coeff=0.01` per step" in section
    assert "used 2 steps after" in section
    assert "each chunk is smoothed: the mean over 5 steps is executed" in section
    assert "a chunk that covers 100 control steps\n" in section
    assert "unknown" in section


def test_the_card_is_lerobot_s_with_our_section_and_no_secrets(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("sys.argv", ["lerobot-train", "--wandb.api_key=abc123", "--steps=9"])
    card = extend_card(ModelCard("---\nlicense: mit\n---\n# Model Card\n"), Settings())
    assert str(card).startswith("---\nlicense: mit\n---\n# Model Card\n\n## How `act_chunked` acts")
    assert "lerobot-train --wandb.api_key=... --steps=9" in str(card)
    assert "abc123" not in str(card)


@pytest.fixture
def remote(hub: LocalHub, api: HfApi, folder: Path, tmp_path: Path) -> LocalHub:
    """Fill the local hub; return another one that plays the real Hub from now on."""
    api.create_repo("me/act")
    for number in range(3):
        (folder / "model.safetensors").write_bytes(os.urandom(70_000))
        (folder / f"only-{number}.txt").touch()
        api.upload_folder(
            repo_id="me/act", folder_path=folder, delete_patterns="only-*", commit_message=f"step {number}"
        )
        (folder / f"only-{number}.txt").unlink()
        if number < 2:
            api.create_tag("me/act", tag=f"00000{number}")
    remote = LocalHub(tmp_path / "remote")
    routing.route_to(remote)
    return remote


def test_publishing_sends_tags_and_the_newest_revision_in_order(hub: LocalHub, remote: LocalHub):
    addresses = publish(hub.open(MODEL), HfApi(), repo_id="you/act", private=True)
    assert len(addresses) == 3
    assert remote.names() == [RepoName("model", "you/act")]
    here, there = hub.open(MODEL), remote.open(RepoName("model", "you/act"))
    assert there.folder.stat().st_mode & 0o777 == 0o700
    for name in ("main", "000000", "000001"):
        assert there.commit(there.resolve(name)).files == here.commit(here.resolve(name)).files
    titles = [commit.title for _, commit in there.history(there.resolve("main"))]
    assert titles == ["step 2", "step 1", "step 0", "initial commit"]


def test_publishing_again_sends_nothing_new(hub: LocalHub, remote: LocalHub):
    publish(hub.open(MODEL), HfApi())
    before = remote.open(MODEL).revisions()
    publish(hub.open(MODEL), HfApi())
    assert remote.open(MODEL).revisions() == before


def command(hub: LocalHub, *arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, [*arguments, "--dir", str(hub.root)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.output


def test_the_command_line_lists_shows_verifies_and_deletes(hub: LocalHub, remote: LocalHub):
    status, output = command(hub, "list")
    assert status == 0
    assert "me/act" in output
    assert "4 revisions, 2 tags" in output

    status, output = command(hub, "show", "me/act", "--revision", "000001")
    head = hub.open(MODEL).resolve("000001")
    assert f"tag     000001  {head[:12]}" in output
    assert "only-1.txt" in output
    assert "only-2.txt" not in output
    assert str(hub.root / "models--me--act" / "snapshots" / head) in output

    assert command(hub, "verify") == (0, "model me/act: intact, 4 revisions load\n")
    (hub.open(MODEL).ref_folder / "000000").write_text("garbage")
    status, output = command(hub, "verify", "me/act")
    assert status == EXIT_CODES["fail"]
    assert "1 problems" in output
    assert "still loads: 000001, main" in output

    status, output = command(hub, "delete", "me/act", "--history")
    assert output.startswith("dropped 2 revisions")
    status, output = command(hub, "delete", "me/act", "--revision", "000001")
    assert output.startswith("dropped 1 revisions, freed 1 files")
    with pytest.raises(ActChunkingError, match="exclude each other"):
        command(hub, "delete", "me/act", "--history", "--revision", "main")
    command(hub, "delete", "me/act")
    assert hub.names() == []
    with pytest.raises(ActChunkingError, match="not in the local hub"):
        command(hub, "show", "me/act")


def test_the_command_line_publishes(hub: LocalHub, remote: LocalHub):
    status, output = command(hub, "publish", "me/act", "--to", "you/act")
    assert status == 0
    assert output.count("https://huggingface.co/you/act/commit/") == 3


def test_the_command_line_needs_a_folder():
    result = CliRunner().invoke(app, ["list"])
    assert "set LEROBOT_LOCAL_HUB or give --dir" in str(result.exception)


def test_run_gives_the_hub_to_any_lerobot_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    seen = []

    class Script:
        name = "lerobot-edit-dataset"

        def load(self):
            import sys

            from huggingface_hub import get_session

            return lambda: seen.append((sys.argv, get_session()._transport.hub.root))

    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: [Script()])
    monkeypatch.setattr("sys.argv", [])
    monkeypatch.setenv(routing.LOCAL_HUB, str(tmp_path / "hub"))
    result = CliRunner().invoke(
        app, ["run", "lerobot-edit-dataset", "--repo_id", "me/cube", "--push_to_hub=true"]
    )
    assert result.exception is None
    expected = ["lerobot-edit-dataset", "--repo_id", "me/cube", "--push_to_hub=true"]
    assert seen == [(expected, tmp_path / "hub")]
    result = CliRunner().invoke(app, ["run", "lerobot-nothing"])
    assert "unknown command 'lerobot-nothing'; choose one of: lerobot-edit-dataset" in str(result.exception)


def test_a_published_repository_loads_by_its_new_name(hub: LocalHub, remote: LocalHub, folder: Path):
    publish(hub.open(MODEL), HfApi(), repo_id="you/act")
    loaded = Path(snapshot_download("you/act"))
    assert (loaded / "model.safetensors").read_bytes() == (folder / "model.safetensors").read_bytes()
