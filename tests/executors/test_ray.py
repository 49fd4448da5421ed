"""The same results on Ray, bit for bit, also when a worker is killed; and what is refused."""

import importlib
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from tiers import full_tier

from lerobot_act_chunking.cli.main import main
from lerobot_act_chunking.diagnostics.core.environments import EnvironmentSpec, environment_of
from lerobot_act_chunking.diagnostics.modes import settings as modes_settings
from lerobot_act_chunking.diagnostics.modes.playing import play
from lerobot_act_chunking.diagnostics.tune import settings as tune_settings
from lerobot_act_chunking.diagnostics.tune.diagnosis import diagnose as tune
from lerobot_act_chunking.errors import ConfigurationError, WorkerError
from lerobot_act_chunking.executors import Cluster, each_done, open_executor
from lerobot_act_chunking.policies.loading import read_config
from lerobot_act_chunking.recording import RecordSpec, record

RECORD = ["record", "--repo-id", "me/cube", "--executor", "ray"]
EXTRA = "lerobot_act_chunking.executors.ray"


@contextmanager
def reader(places):
    """Answers a folder with where it is and what is in it, a number by dying, and an error by raising it."""

    def read(item):
        if isinstance(item, int):
            os.kill(os.getpid(), signal.SIGKILL)
        if isinstance(item, Exception):
            raise item
        with places(item) as folder:
            return folder, {path.name: path.read_bytes() for path in Path(folder).rglob("*.txt")}

    yield read


@contextmanager
def lacking(places):
    raise ModuleNotFoundError("No module named 'strange_world'")
    yield


def test_ray_that_is_not_installed_is_told_with_its_command(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.delitem(sys.modules, EXTRA, raising=False)
    assert main(RECORD) == 1
    assert (
        "--executor ray needs ray: pip install 'lerobot_policy_act_chunking[ray]'" in capsys.readouterr().err
    )


@pytest.mark.parametrize("address", ["127.0.0.1:1", "ray://127.0.0.1:1", "127.0.0.1:port", "nowhere"])
def test_an_address_without_a_cluster_is_named(address, capsys):
    assert main([*RECORD, "--address", address]) == 1
    message = capsys.readouterr().err
    assert f"--address={address}: there is no Ray cluster" in message
    assert "ray start --head" in message


def test_an_address_without_ray_is_refused(capsys):
    assert main([*RECORD[:-2], "--address", "auto"]) == 1
    assert "--address=auto is of a Ray cluster: give --executor=ray as well" in capsys.readouterr().err


def test_other_versions_are_named():
    from lerobot_act_chunking.executors.ray import check_versions, versions

    check_versions(versions(), versions())
    with pytest.raises(ConfigurationError, match=r"worker of the cluster has numpy 1\.0, here 2"):
        check_versions({**versions(), "numpy": "1.0"}, {**versions(), "numpy": "2"})


@pytest.fixture
def benchmark(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))
    return importlib.import_module("executors")


@full_tier
@pytest.mark.filterwarnings("default")
class TestCluster:
    """One Ray of this machine for all: it takes long to start."""

    def test_folders_travel_errors_come_back_and_deaths_are_counted(self, tmp_path):
        (tmp_path / "in").mkdir()
        (tmp_path / "in" / "weights.txt").write_bytes(b"12")
        with open_executor(reader, 2, Cluster(), [str(tmp_path)]) as executor:
            ((_, (place, found)),) = each_done(executor, [str(tmp_path)])
            assert place != str(tmp_path)
            assert found == {"weights.txt": b"12"}
            ((_, (place, _)),) = each_done(executor, ["me/repository"])
            assert place == "me/repository"
            with pytest.raises(ConfigurationError, match="cursed"):
                list(each_done(executor, [ConfigurationError("cursed")]))
            with pytest.raises(WorkerError, match="3 workers died one after the other"):
                list(each_done(executor, [1]))

    def test_what_a_worker_lacks_is_named(self, monkeypatch):
        from lerobot_act_chunking.executors import ray

        with (
            open_executor(lacking, 1, Cluster()) as executor,
            pytest.raises(ConfigurationError, match=r"cannot begin \(No module named 'strange_world'\)"),
        ):
            list(each_done(executor, [0]))
        monkeypatch.setattr(ray, "versions", lambda: {"numpy": "0.1"})
        with (
            open_executor(reader, 1, Cluster()) as executor,
            pytest.raises(ConfigurationError, match=r"has numpy 2\S*, here 0\.1: install the same"),
        ):
            list(each_done(executor, [""]))

    def test_ctrl_c_stops_and_the_same_command_goes_on_without_ray(self, tmp_path):
        root, episodes = tmp_path / "gates", tmp_path / ".gates.recording" / "episodes"
        command = [sys.executable, "-m", "lerobot_act_chunking.cli.main", *RECORD[:3], "--env", "three_gates"]
        command += ["--root", str(root), "--episodes", "300"]
        on_ray = [*command, "--executor", "ray", "--workers", "2"]
        with subprocess.Popen(on_ray, stderr=subprocess.PIPE, text=True, start_new_session=True) as process:
            while process.poll() is None and len(list(episodes.glob("seed-*.npz"))) < 3:
                time.sleep(0.02)
            os.killpg(process.pid, signal.SIGINT)
            assert "stopped; run the same command again to go on from here" in process.stderr.read()
        assert process.returncode == 130
        assert not root.exists()
        assert len(list(episodes.glob("seed-*.npz"))) >= 3
        subprocess.run(command, check=True, capture_output=True, timeout=600)
        record(RecordSpec("me/cube", tmp_path / "whole", env="three_gates", episodes=300))
        recorded, whole = (
            {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*.*")}
            for folder in (root, tmp_path / "whole")
        )
        assert recorded == whole

    def test_the_benchmark_finds_everything_equal(self, tmp_path, benchmark):
        found = benchmark.measure(tmp_path, 6, 1)
        assert found["same"]
        assert found["killed"] == {name: {"died": 1, "same": True} for name in ("local", "ray")}
        assert found["eval_same"] == {"local": True, "ray": True}

    def test_tune_and_modes_run_the_same_episodes(self, tmp_path, benchmark):
        checkpoint = benchmark.untrained(tmp_path / "policy")
        short = EnvironmentSpec(
            "aloha_sim", {"obs_type": "state", "task": "transfer_cube", "episode_length": 3}
        )
        env_config = environment_of(read_config(checkpoint), short, checkpoint)

        def tuned(name, **workers):
            asked = tune_settings.Settings(
                checkpoint, short, episodes=2, minutes=60, output_dir=tmp_path / name, **workers
            )
            return tune(asked).race.results

        def moved(**workers):
            asked = modes_settings.Settings(checkpoint, short, episodes=3, batch_size=2, **workers)
            return [
                (each.seed, each.commands.tobytes(), *(one.chunk.tobytes() for one in each.inferences))
                for each in play(asked, env_config, None)
            ]

        assert tuned("ray", workers=2, cluster=Cluster()) == tuned("here")
        assert moved(workers=2, cluster=Cluster()) == moved()
