"""LeRobot's own training command: it runs, and a resumed run is the undisturbed one."""

import json
import sys

import numpy as np
import pytest
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.scripts import lerobot_train
from safetensors.torch import load_file

from lerobot_act_chunking.cli.main import main
from lerobot_act_chunking.errors import ConfigurationError, DatasetError

pytestmark = pytest.mark.slow

# Without dropout: LeRobot's new data loader draws from the random generator that resuming has just restored.
SMALL = {
    "act_chunked": "--policy.dim_model=16 --policy.n_heads=2 --policy.chunk_size=5 --policy.use_ema=true "
    "--policy.dropout=0",
    "diffusion_chunked": "--policy.dim_model=16 --policy.n_layers=1 --policy.horizon=5",
    "vqbet_chunked": "--policy.gpt_hidden_dim=16 --policy.gpt_n_layer=1 --policy.chunk_size=5 "
    "--policy.vqvae_n_embed=3 --policy.n_vqvae_training_steps=3 --policy.offset_target=sampled",
}


def record(root, spoiled=None, length=12):
    """Two episodes of ``length`` frames; the first frame of the feature ``spoiled`` holds a NaN."""
    names = {"observation.state": 6, "observation.environment_state": 7, "action": 4}
    features = {key: {"dtype": "float32", "shape": (n,), "names": None} for key, n in names.items()}
    dataset = LeRobotDataset.create("test/toy", fps=50, features=features, root=root, use_videos=False)
    generator = np.random.default_rng(0)
    for _ in range(2):
        for i in range(length):
            frame = {key: generator.normal(size=n).astype(np.float32) for key, n in names.items()}
            if spoiled is not None and i == 0:
                frame[spoiled][0] = np.nan
            dataset.add_frame({**frame, "task": "toy"})
        dataset.save_episode()
    dataset.finalize()
    return root


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return record(tmp_path_factory.mktemp("toy") / "dataset")


@pytest.fixture
def train(monkeypatch):
    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["lerobot-train", *arguments])
        lerobot_train.main()

    return run


def fresh(dataset, output, *arguments, policy_type="act_chunked"):
    run = f"--dataset.root={dataset} --output_dir={output} --dataset.repo_id=test/toy --batch_size=3"
    quiet = "--policy.device=cpu --policy.push_to_hub=false --num_workers=0 --log_freq=1 --save_freq=2"
    return [*f"--policy.type={policy_type} {run} {quiet} {SMALL[policy_type]}".split(), *arguments]


def weights(run, step):
    return load_file(run / "checkpoints" / step / "pretrained_model" / "model.safetensors")


@pytest.mark.parametrize("policy_type", SMALL)
def test_a_resumed_run_is_the_undisturbed_one(train, dataset, tmp_path, policy_type):
    train(*fresh(dataset, tmp_path / "whole", "--steps=4", policy_type=policy_type))
    config = tmp_path / "whole" / "checkpoints" / "000002" / "pretrained_model" / "train_config.json"
    train(f"--config_path={config}", "--resume=true", f"--output_dir={tmp_path / 'resumed'}")
    whole, resumed = weights(tmp_path / "whole", "000004"), weights(tmp_path / "resumed", "000004")
    assert whole.keys() == resumed.keys()
    for name, value in whole.items():
        assert value.equal(resumed[name]), name


LENGTHS = [("act_chunked", "chunk_size"), ("diffusion_chunked", "horizon"), ("vqbet_chunked", "chunk_size")]


def saved(run):
    return json.loads((run / "checkpoints/last/pretrained_model/config.json").read_text())


@pytest.mark.parametrize(("policy_type", "name"), LENGTHS)
def test_a_chunk_longer_than_every_episode_is_executed_as_far_as_it_is_taught(
    train, dataset, tmp_path, policy_type, name, capsys
):
    long = [f"--policy.{name}=15", "--steps=4"]
    train(*fresh(dataset, tmp_path / "run", *long, policy_type=policy_type))
    config = saved(tmp_path / "run")
    assert (config[name], config["n_action_steps"]) == (15, 12)
    lines = [line for line in capsys.readouterr().err.splitlines() if "longest episode (12 steps)" in line]
    assert len(lines) == 1
    assert f"--policy.{name}=12" in lines[0]


@pytest.mark.parametrize(("policy_type", "name"), LENGTHS)
def test_fine_tuning_on_shorter_episodes_keeps_what_the_weights_make_possible(
    train, dataset, tmp_path, policy_type, name, capsys
):
    train(*fresh(dataset, tmp_path / "first", "--steps=4", policy_type=policy_type))
    short = record(tmp_path / "short", length=4)
    checkpoint = tmp_path / "first/checkpoints/last/pretrained_model"
    tuned = fresh(short, tmp_path / "tuned", "--steps=2", policy_type=policy_type)
    capsys.readouterr()
    train(f"--policy.path={checkpoint}", *(each for each in tuned if "--policy." not in each))
    config = saved(tmp_path / "tuned")
    assert (config[name], config["n_action_steps"]) == (5, 5)
    (line,) = [line for line in capsys.readouterr().err.splitlines() if "longest episode (4 steps)" in line]
    assert "executes steps from 4 on, as the checkpoint learned them" in line
    assert f"--policy.{name}" not in line  # the weights rule it out


def test_a_run_must_reach_the_policy(train, dataset, tmp_path):
    with pytest.raises(
        ConfigurationError, match=r"steps=3 are over .* the first 3 .* --steps to more than 3"
    ):
        train(*fresh(dataset, tmp_path / "run", "--steps=3", policy_type="vqbet_chunked"))
    train(*fresh(dataset, tmp_path / "four", "--steps=4", policy_type="vqbet_chunked"))
    checkpoint = tmp_path / "four/checkpoints/last/pretrained_model"
    tuned = fresh(dataset, tmp_path / "tuned", "--steps=2", policy_type="vqbet_chunked")
    train(f"--policy.path={checkpoint}", *(each for each in tuned if "--policy." not in each))
    learned = weights(tmp_path / "tuned", "last")["tokenizer_phase.n_learned"]
    assert learned == 3  # so that a shorter run is enough: nothing is left to the tokenizer


def test_a_nan_in_the_dataset_is_refused(train, tmp_path):
    spoiled = record(tmp_path / "dataset", spoiled="observation.state")
    with pytest.raises(DatasetError, match=r"observation\.state"):
        train(*fresh(spoiled, tmp_path / "run"))


def test_fine_tuning_starts_from_the_checkpoint(train, dataset, tmp_path):
    train(*fresh(dataset, tmp_path / "first", "--steps=2"))
    checkpoint = tmp_path / "first" / "checkpoints" / "last" / "pretrained_model"
    arguments = [argument for argument in fresh(dataset, tmp_path / "second") if "--policy." not in argument]
    train(*arguments, f"--policy.path={checkpoint}", "--policy.push_to_hub=false", "--steps=2")
    second = load_file(
        tmp_path / "second" / "checkpoints" / "last" / "pretrained_model" / "model.safetensors"
    )
    assert second["ema.step"] == 4


def test_a_tokenizer_trained_apart_stays_as_it_is(train, dataset, tmp_path):
    tokenizer = tmp_path / "tokenizer.safetensors"
    made = f"{dataset} --out {tokenizer} --chunk-size 5 --chunk-stride 1 --steps 3 --batch-size 8"
    assert main(["train-tokenizer", *made.split()]) == 0
    settings = fresh(dataset, tmp_path / "run", policy_type="vqbet_chunked")
    settings = [each for each in settings if "vqvae" not in each and "chunk_size" not in each]
    train(*settings, f"--policy.tokenizer_path={tokenizer}", "--steps=4")
    tokenizer.unlink()  # from here on it is in the checkpoint
    config = tmp_path / "run" / "checkpoints" / "000002" / "pretrained_model" / "train_config.json"
    train(f"--config_path={config}", "--resume=true", f"--output_dir={tmp_path / 'resumed'}")
    whole, resumed = weights(tmp_path / "run", "000004"), weights(tmp_path / "resumed", "000004")
    first = weights(tmp_path / "run", "000002")
    for name, value in whole.items():
        assert value.equal(resumed[name]), name
        if name.startswith("tokenizer."):
            assert value.equal(first[name]), name
