"""LeRobot's own training command with the wrapper: from scratch, resumed, and from an inner checkpoint."""

import json
import shutil
import sys

import numpy as np
import pytest
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.scripts import lerobot_train
from safetensors.torch import load_file
from tiers import full_tier
from wrapped_cases import ACT, DIFFUSION

from lerobot_act_chunking.policies.loading import load_policy

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Two episodes of 20 frames."""
    root = tmp_path_factory.mktemp("toy") / "dataset"
    sizes = {"observation.state": 6, "observation.environment_state": 7, "action": 4}
    features = {key: {"dtype": "float32", "shape": (n,), "names": None} for key, n in sizes.items()}
    dataset = LeRobotDataset.create("test/toy", fps=50, features=features, root=root, use_videos=False)
    generator = np.random.default_rng(0)
    for _ in range(2):
        for _ in range(20):
            frame = {key: generator.normal(size=n).astype(np.float32) for key, n in sizes.items()}
            dataset.add_frame({**frame, "task": "toy"})
        dataset.save_episode()
    dataset.finalize()
    return root


@pytest.fixture
def train(monkeypatch, dataset):
    def run(output, *arguments):
        data = f"--dataset.root={dataset} --dataset.repo_id=test/toy --batch_size=3 --num_workers=0"
        quiet = "--policy.push_to_hub=false --log_freq=1 --save_freq=2 --policy.device=cpu"
        fresh = [] if "--resume=true" in arguments else f"{data} {quiet}".split()
        monkeypatch.setattr(sys, "argv", ["lerobot-train", *fresh, f"--output_dir={output}", *arguments])
        lerobot_train.main()

    return run


def checkpoint(run, step="last"):
    return run / "checkpoints" / step / "pretrained_model"


def weights(folder):
    return load_file(folder / "model.safetensors")


def same(one, other):
    return one.keys() == other.keys() and all(value.equal(other[name]) for name, value in one.items())


# VQ-BeT's and ACT's VAE draw random numbers in training; LeRobot's data loader draws from the same generator
# when it starts, so that only a policy without them resumes bit for bit.
INNER = {**ACT.inner, "use_vae": False, "optimizer_lr": 1e-3}


def test_from_scratch_resumed_is_the_undisturbed_run(train, tmp_path):
    whole, resumed = tmp_path / "whole", tmp_path / "resumed"
    inner = ["--policy.type=temporal_ensemble", f"--policy.inner={json.dumps(INNER)}"]
    train(whole, *inner, "--policy.replan_interval=2", "--steps=4")
    train(resumed, f"--config_path={checkpoint(whole, '000002') / 'train_config.json'}", "--resume=true")
    assert same(weights(checkpoint(whole)), weights(checkpoint(resumed)))
    assert not same(weights(checkpoint(whole)), weights(checkpoint(whole, "000002")))
    loaded = load_policy(checkpoint(resumed))
    assert loaded.policy.config.replan_interval == 2
    assert loaded.policy.config.input_features == ACT.inputs
    loaded.policy.select_action(loaded.preprocessor(ACT.batch()))


@full_tier
@pytest.mark.parametrize("case", [ACT, DIFFUSION], ids=lambda case: case.type)
def test_an_inner_checkpoint_is_continued_and_no_longer_needed(case, train, tmp_path):
    inner = case.checkpoint(tmp_path / "inner")
    start = {f"inner.{name}": value for name, value in weights(inner).items()}
    run = tmp_path / "run"
    # Without a learning rate, training ends where it began.
    settings = json.loads((inner / "config.json").read_text())
    (inner / "config.json").write_text(json.dumps({**settings, "optimizer_lr": 0.0}))
    train(run, "--policy.type=temporal_ensemble", f"--policy.inner_path={inner}", "--steps=2")
    reached = weights(checkpoint(run))
    assert same(reached, start)
    shutil.rmtree(inner)
    config = checkpoint(run) / "train_config.json"
    train(tmp_path / "resumed", f"--config_path={config}", "--resume=true", "--steps=4")
    loaded = load_policy(checkpoint(tmp_path / "resumed"))
    assert loaded.policy.config.inner_source is None
    assert loaded.policy.config.chunk_size == case.chunk_size
    loaded.policy.select_action(loaded.preprocessor(case.batch()))
    train(tmp_path / "tuned", f"--policy.path={checkpoint(run)}", "--steps=2")
    assert weights(checkpoint(tmp_path / "tuned")).keys() == reached.keys()
