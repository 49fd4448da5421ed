"""LeRobot's own commands against the local hub, with every socket to the network blocked."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from huggingface_hub import scan_cache_dir
from policy_cases import MODULES, TYPES
from tiers import full_tier

from lerobot_act_chunking.compat import trackers_off
from lerobot_act_chunking.hub.names import RepoName
from lerobot_act_chunking.hub.storage import LocalHub
from lerobot_act_chunking.hub.verifying import verify

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1500)]

SEALED = """
import os, socket, sys

def refuse(self, address, _connect=socket.socket.connect):
    if self.family == socket.AF_UNIX:  # between processes of one machine
        return _connect(self, address)
    raise OSError(f"the test forbids the network: {address}")

socket.socket.connect = socket.socket.connect_ex = refuse

class NoPlugin:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("lerobot_act_chunking", "lerobot_policy_act_chunking"):
            raise ImportError(f"{name} is not installed")

if os.environ.get("WITHOUT_PLUGIN"):
    sys.meta_path.insert(0, NoPlugin())
"""

MAKE_DATASET = """
import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset
features = {
    "observation.state": {"dtype": "float32", "shape": (14,), "names": None},
    "observation.environment_state": {"dtype": "float32", "shape": (7,), "names": None},
    "action": {"dtype": "float32", "shape": (14,), "names": None},
}
dataset = LeRobotDataset.create("me/cube", fps=50, features=features, root=ROOT, use_videos=False)
draw = np.random.default_rng(0)
for episode in range(2):
    for step in range(20):
        frame = {key: draw.standard_normal(f["shape"]).astype("float32") for key, f in features.items()}
        dataset.add_frame({**frame, "task": "hand the cube over"})
    dataset.save_episode()
dataset.finalize()
"""

PUSH_DATASET = """
import lerobot_policy_act_chunking
from lerobot.datasets.lerobot_dataset import LeRobotDataset
import torch
made = LeRobotDataset("me/cube", root=ROOT)
made.push_to_hub(private=True)
loaded = LeRobotDataset("me/cube")
assert str(loaded.root) != str(made.root), loaded.root
assert len(loaded) == len(made) == 40
for index in range(len(made)):
    a, b = made[index], loaded[index]
    assert a.keys() == b.keys()
    for key in a:
        assert torch.equal(a[key], b[key]) if isinstance(a[key], torch.Tensor) else a[key] == b[key], key
assert made.meta.stats.keys() == loaded.meta.stats.keys()
"""

LOAD_UNMODIFIED = """
import importlib.util, torch
try:
    import lerobot_act_chunking
except ImportError:
    pass
else:
    raise SystemExit("this environment was meant to be without the package")
from lerobot.configs.policies import PreTrainedConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors
for revision in ("main", "v1"):
    policy = ACTPolicy.from_pretrained("me/act", revision=revision)
    policy.config.pretrained_revision = revision
    before, after = make_pre_post_processors(policy.config, pretrained_path="me/act")
    observation = {"observation.state": torch.ones(14), "observation.environment_state": torch.ones(7)}
    action = after(policy.select_action(before(observation)))
    assert action.shape == (1, 14) and action.isfinite().all()
print("loaded", PreTrainedConfig.from_pretrained("me/act").type)
"""

TAG = """
import lerobot_policy_act_chunking
from huggingface_hub import HfApi
HfApi().create_tag("REPO", tag="v1")
"""

TINY_ACT = [
    "--policy.type=act",
    "--policy.dim_model=32",
    "--policy.n_heads=2",
    "--policy.dim_feedforward=16",
    "--policy.n_encoder_layers=1",
    "--policy.n_vae_encoder_layers=1",
    "--policy.chunk_size=8",
    "--policy.n_action_steps=8",
    "--policy.repo_id=me/act",
]
TINY_CHUNKED = [
    f"--policy.type={TYPES[0]}",
    *MODULES[TYPES[0]].TRAINED.split(),
    "--policy.repo_id=me/act_cube",
]
TRAIN = [
    "--policy.device=cpu",
    "--dataset.repo_id=me/cube",
    "--batch_size=2",
    "--num_workers=0",
    "--log_freq=1",
    *trackers_off(),
]
EVAL = [
    "--policy.device=cpu",
    "--env.type=aloha_sim",
    "--env.obs_type=state",
    "--env.episode_length=10",
    "--eval.n_episodes=1",
    "--eval.batch_size=1",
    "--eval.use_async_envs=false",
]


class Workstation:
    """A fresh user on a machine without a network: nothing cached, nobody logged in, one hub folder."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.hub = folder / "hub"
        (folder / "site").mkdir()
        (folder / "site" / "sitecustomize.py").write_text(SEALED)

    def environment(self, **changes: str) -> dict[str, str]:
        dropped = ("HF_", "HUGGING", "LEROBOT", "WANDB")
        kept = {key: value for key, value in os.environ.items() if not key.startswith(dropped)}
        return {
            **kept,
            "HF_HOME": str(self.folder / "hf"),
            "PYTHONPATH": str(self.folder / "site"),
            "PYTHONWARNINGS": "ignore",
            "OMP_NUM_THREADS": "1",
            "MUJOCO_GL": "egl",
            **changes,
        }

    def run(self, command: list[str], **environment: str) -> str:
        environment = environment or {"LEROBOT_LOCAL_HUB": str(self.hub)}
        done = subprocess.run(
            command, cwd=self.folder, env=self.environment(**environment), capture_output=True, text=True
        )
        assert done.returncode == 0, f"{command}\n{done.stdout[-3000:]}\n{done.stderr[-6000:]}"
        return done.stdout + done.stderr

    def lerobot(self, name: str, *arguments: str) -> str:
        return self.run([str(Path(sys.executable).with_name(f"lerobot-{name}")), *arguments])

    def python(self, code: str, **environment: str) -> str:
        code = code.replace("ROOT", repr(str(self.folder / "dataset")))
        return self.run([sys.executable, "-c", code], **environment)


def evaluated(station: Workstation, name: str) -> dict:
    [path] = (station.folder / name).rglob("eval_info.json")
    return json.loads(path.read_text())


@full_tier
def test_train_push_evaluate_resume_without_a_network(tmp_path: Path):
    station = Workstation(tmp_path)
    hub = LocalHub(station.hub)
    station.python(MAKE_DATASET)
    station.python(PUSH_DATASET)
    assert hub.open(RepoName("dataset", "me/cube")).head("v3.0") is not None

    # Train with a push at every checkpoint and one at the end.
    saving = ["--steps=4", "--save_freq=2", "--save_checkpoint_to_hub=true", "--output_dir=run"]
    log = station.lerobot("train", *TINY_CHUNKED, *TRAIN, *saving)
    repository = hub.open(RepoName("model", "me/act_cube"))
    assert repository.tags() == {"000002", "000004"}
    assert str(repository.snapshots) in log
    first = repository.resolve("main")
    shown = set(repository.snapshot_files(first))
    assert {"config.json", "model.safetensors", "train_config.json", "README.md"} <= shown
    assert {"policy_preprocessor.json", "policy_postprocessor.json"} <= shown
    assert "checkpoints/000004/training_state/training_step.json" in shown

    # Evaluate by repository id, name the revision, resume by repository id.
    station.lerobot("eval", "--policy.path=me/act_cube", *EVAL, "--output_dir=eval_main")
    assert evaluated(station, "eval_main")["overall"]["n_episodes"] == 1
    station.python(TAG.replace("REPO", "me/act_cube"))
    station.lerobot(
        "train", "--config_path=me/act_cube", "--resume=true", "--steps=6", "--output_dir=resumed"
    )
    assert repository.tags() == {"000002", "000004", "000006", "v1"}
    assert repository.resolve("main") != repository.resolve("v1") == first
    step = repository.file(
        repository.resolve("000006"), "checkpoints/000006/training_state/training_step.json"
    )
    assert json.loads(step.read_text())["step"] == 6

    # Evaluate the named revision: other weights than main's.
    log = station.lerobot(
        "eval", "--policy.path=me/act_cube", "--policy.pretrained_revision=v1", *EVAL, "--output_dir=eval_v1"
    )
    assert evaluated(station, "eval_v1")["overall"]["n_episodes"] == 1
    weights = {
        repository.commit(repository.resolve(name)).files["model.safetensors"].digest
        for name in ("v1", "main")
    }
    assert len(weights) == 2

    # LeRobot's own policy, pushed the same way, loads where this package does not exist.
    station.lerobot("train", *TINY_ACT, *TRAIN, "--steps=1", "--output_dir=act")
    station.python(TAG.replace("REPO", "me/act"))
    elsewhere = {"HF_HUB_CACHE": str(station.hub), "HF_HUB_OFFLINE": "1", "WITHOUT_PLUGIN": "1"}
    assert "loaded act" in station.python(LOAD_UNMODIFIED, **elsewhere)

    assert scan_cache_dir(station.hub).warnings == []
    for name in hub.names():
        assert verify(hub.open(name)).problems == []


@full_tier
def test_a_run_that_could_not_push_fails_before_it_starts(tmp_path: Path):
    station = Workstation(tmp_path)
    command = [
        str(Path(sys.executable).with_name("lerobot-train")),
        *TINY_CHUNKED,
        *TRAIN,
        "--output_dir=run",
    ]
    done = subprocess.run(
        command, cwd=tmp_path, env=station.environment(), capture_output=True, text=True, check=False
    )
    assert done.returncode != 0
    for words in ("'me/act_cube'", "nobody is logged in", "LEROBOT_LOCAL_HUB=", "--policy.push_to_hub=false"):
        assert words in done.stderr
    assert not (tmp_path / "run").exists()
