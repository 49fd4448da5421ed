"""`act_chunked` with everything that is random and averaged, through LeRobot's own training command."""

import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.factory import get_policy_class
from lerobot.scripts import lerobot_train
from safetensors.torch import load_file
from tiers import some

pytestmark = pytest.mark.slow

# Without dropout: LeRobot's new data loader draws from the random generator that resuming has just restored.
SMALL = (
    "--policy.dim_model=16 --policy.n_heads=2 --policy.n_encoder_layers=1 --policy.n_vae_encoder_layers=1 "
    "--policy.chunk_size=6 --policy.actions_per_query=2 --policy.dropout=0"
)
KINDS = {
    "autoregressive": "--policy.preset=autoregressive --policy.obs_stride=2 --policy.vae_action_stride=3 "
    "--policy.use_ema=true --policy.kl_anneal=linear --policy.kl_anneal_steps=3 --policy.use_amp=true",
    "mixture": "--policy.use_vae=true --policy.latent_type=mixture --policy.latent_warmup_steps=3 "
    "--policy.n_latent_components=2 --policy.z_inference=sample --policy.use_ema=true "
    "--policy.action_likelihood=gmm",
    "categorical": "--policy.use_vae=true --policy.latent_type=categorical --policy.latent_warmup_steps=3 "
    "--policy.decoder_type=autoregressive --policy.action_likelihood=categorical",
}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Two episodes of 12 frames."""
    root = tmp_path_factory.mktemp("toy") / "dataset"
    names = {"observation.state": 6, "observation.environment_state": 7, "action": 4}
    features = {key: {"dtype": "float32", "shape": (n,), "names": None} for key, n in names.items()}
    recording = LeRobotDataset.create("test/toy", fps=50, features=features, root=root, use_videos=False)
    generator = np.random.default_rng(0)
    for _ in range(2):
        for _ in range(12):
            frame = {key: generator.normal(size=n).astype(np.float32) for key, n in names.items()}
            recording.add_frame({**frame, "task": "toy"})
        recording.save_episode()
    recording.finalize()
    return root


@pytest.fixture
def train(monkeypatch):
    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["lerobot-train", *arguments])
        lerobot_train.main()

    return run


def fresh(dataset, output, *arguments, policy=f"--policy.type=act_chunked {SMALL}"):
    run = f"--dataset.root={dataset} --output_dir={output} --dataset.repo_id=test/toy --batch_size=3"
    quiet = "--policy.device=cpu --policy.push_to_hub=false --num_workers=0 --log_freq=1 --save_freq=2"
    return [*f"{run} {quiet} {policy}".split(), *arguments]


def checkpoint(run: Path, step: str) -> Path:
    return run / "checkpoints" / step / "pretrained_model"


def weights(run: Path, step: str) -> dict[str, torch.Tensor]:
    return load_file(checkpoint(run, step) / "model.safetensors")


def assert_equal(first, second):
    assert first.keys() == second.keys()
    for name, value in first.items():
        assert torch.equal(value, second[name]), name


@pytest.mark.parametrize("kind", some(1, KINDS))
def test_a_resumed_run_is_the_undisturbed_one(train, dataset, tmp_path, kind):
    train(*fresh(dataset, tmp_path / "whole", "--steps=4", *KINDS[kind].split()))
    config = checkpoint(tmp_path / "whole", "000002") / "train_config.json"
    train(f"--config_path={config}", "--resume=true", f"--output_dir={tmp_path / 'resumed'}")
    whole = weights(tmp_path / "whole", "000004")
    assert_equal(whole, weights(tmp_path / "resumed", "000004"))
    halfway = weights(tmp_path / "whole", "000002")
    assert any(not torch.equal(value, halfway[name]) for name, value in whole.items())


def test_equal_weights_of_samples_change_nothing(train, dataset, tmp_path):
    for name, weighting in (("plain", ()), ("weighted", ("--sample_weighting.type=uniform",))):
        train(*fresh(dataset, tmp_path / name, "--steps=2", *KINDS["mixture"].split(), *weighting))
    plain, weighted = (weights(tmp_path / name, "000002") for name in ("plain", "weighted"))
    for name, value in plain.items():
        torch.testing.assert_close(weighted[name], value, rtol=1e-3, atol=1e-5, msg=name)


@pytest.mark.parametrize("decoder", ["parallel", "autoregressive"])
def test_lerobot_adapts_a_trained_policy(train, dataset, tmp_path, decoder):
    """Only adapters and the head learn, and what they learn is in effect when acting."""
    pytest.importorskip("peft")
    train(*fresh(dataset, tmp_path / "first", "--steps=2", f"--policy.decoder_type={decoder}"))
    base = checkpoint(tmp_path / "first", "last")
    config = PreTrainedConfig.from_pretrained(base)
    config.pretrained_path = base
    policy = get_policy_class("act_chunked").from_pretrained(base, config=config)
    batch = {"observation.state": torch.ones(2, 6), "observation.environment_state": torch.ones(2, 7)}
    before = policy.predict_action_chunk(batch)
    adapted = policy.wrap_with_peft(peft_cli_overrides={"r": 2})
    learns = [name for name, parameter in adapted.named_parameters() if parameter.requires_grad]
    assert all("lora_" in name or "modules_to_save" in name for name in learns)
    assert any(".encoder." in name for name in learns)
    assert any(".decoder." in name for name in learns)
    for name, parameter in adapted.named_parameters():
        if "lora_B" in name:  # zero at first, so that nothing changes
            parameter.data.fill_(0.1)
    apart = adapted.predict_action_chunk(batch)
    assert (apart - before).abs().max() > 1e-3
    merged = adapted.merge_and_unload().predict_action_chunk(batch)
    torch.testing.assert_close(merged, apart, rtol=1e-4, atol=1e-5)


def test_adapters_are_trained_by_lerobots_command(train, dataset, tmp_path):
    pytest.importorskip("peft")
    train(*fresh(dataset, tmp_path / "first", "--steps=2"))
    path = f"--policy.path={checkpoint(tmp_path / 'first', 'last')}"
    train(*fresh(dataset, tmp_path / "second", "--peft.r=2", "--steps=2", policy=path))
    assert (checkpoint(tmp_path / "second", "last") / "adapter_model.safetensors").exists()
