"""``act-chunking codebook`` as a user meets it."""

import json

import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors

import lerobot_act_chunking.policies.vqbet_chunked.configuration_vqbet_chunked  # noqa: F401  (registers)
from lerobot_act_chunking.cli.main import main
from lerobot_act_chunking.diagnostics.codebook.comparison import measuring
from lerobot_act_chunking.diagnostics.codebook.comparison.candidates import Candidate
from lerobot_act_chunking.policies.vqbet_chunked.tokenizer_file import (
    TokenizerInfo,
    TokenizerTraining,
    save_tokenizer,
)
from lerobot_act_chunking.tokenizers.make import make_tokenizer
from lerobot_act_chunking.tokenizers.spec import TokenizerSpec

PASSED, FAILED, REFUSED = 0, 11, 1
S, A, C = 3, 2, 4
INPUTS = {"observation.state": PolicyFeature(FeatureType.STATE, (S,))}
OUTPUTS = {"action": PolicyFeature(FeatureType.ACTION, (A,))}


def write_dataset(folder, *, episodes=3, width=A, height=1.0):
    features = {
        "action": {"dtype": "float32", "shape": (width,), "names": [f"joint_{i}" for i in range(width)]},
        "observation.state": {"dtype": "float32", "shape": (S,), "names": None},
    }
    dataset = LeRobotDataset.create("me/waves", fps=20, features=features, root=folder)
    for episode in range(episodes):
        for step in range(140):
            action = height * np.sin(0.06 * step + episode + np.arange(width))
            state = np.full(S, step, np.float32)
            dataset.add_frame(
                {"action": action.astype(np.float32), "observation.state": state, "task": "wave"}
            )
        dataset.save_episode()
    dataset.finalize()
    return str(folder)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return write_dataset(tmp_path_factory.mktemp("data") / "waves")


def write_tokenizer(path, dataset, **settings):
    """Bins of each action: nothing to train, nothing lost."""
    config = PreTrainedConfig.get_choice_class("vqbet_chunked")(device="cpu", tokenizer="uniform", n_bins=64)
    spec = TokenizerSpec.from_fields(config, chunk_size=C, action_dim=A)
    bounds = {"min": [-1.0] * A, "max": [1.0] * A}
    info = TokenizerInfo(spec, 2, "MIN_MAX", 1e-2, bounds, dataset, 330, TokenizerTraining())
    save_tokenizer(path, make_tokenizer(spec), info)
    return str(path)


def write_checkpoint(folder, *, dataset=None, episodes=None, n_learned=7):
    config = PreTrainedConfig.get_choice_class("vqbet_chunked")(
        device="cpu",
        push_to_hub=False,
        chunk_size=C,
        vqvae_num_layers=2,
        vqvae_n_embed=8,
        kmeans_iters=0,
        n_vqvae_training_steps=7,
        gpt_hidden_dim=8,
        gpt_n_layer=1,
        gpt_n_head=2,
        head_hidden_dims=(8,),
        use_ema=False,
        input_features=dict(INPUTS),
        output_features=dict(OUTPUTS),
    )
    torch.manual_seed(0)
    policy = get_policy_class("vqbet_chunked")(config)
    policy.tokenizer_phase.n_learned.fill_(n_learned)
    stats = {
        key: {"mean": torch.zeros(n), "std": torch.ones(n)}
        for key, n in (("observation.state", S), ("action", A))
    }
    for part in (policy, *make_pre_post_processors(config, dataset_stats=stats)):
        part.save_pretrained(folder)
    if dataset is not None:
        trained_on = {"dataset": {"root": dataset, "repo_id": "me/waves", "episodes": episodes}}
        (folder / "train_config.json").write_text(json.dumps(trained_on))
    return str(folder)


def test_a_tokenizer_file(dataset, tmp_path, capsys):
    file = write_tokenizer(tmp_path / "bins.safetensors", dataset)
    numbers, picture = tmp_path / "new" / "codebook.json", tmp_path / "codebook.png"
    assert main(["codebook", file, "--json", str(numbers), "--out", str(picture)]) == PASSED
    content = json.loads(numbers.read_text(), parse_constant=pytest.fail)
    assert content["verdict"] == "pass"
    assert content["kind"] == "tokenizer file"
    assert content["dataset"] == dataset
    assert (content["chunk_size"], content["chunk_stride"]) == (C, 2)
    assert max(loss["p95"] for loss in content["losses"]["dimensions"]) < 1.01 / 64
    assert picture.read_bytes().startswith(b"\x89PNG")
    printed = capsys.readouterr().out
    assert "uniform: 8 codes of 64 for 4 actions" in printed
    assert "joint_1" in printed


def test_a_checkpoint_against_other_data(dataset, tmp_path, capsys):
    other = write_dataset(tmp_path / "other", episodes=2, height=3.0)
    checkpoint = write_checkpoint(tmp_path / "policy", dataset=dataset, episodes=[0, 2])
    numbers = tmp_path / "codebook.json"
    assert main(["codebook", checkpoint, "--dataset", other, "--json", str(numbers)]) == FAILED
    content = json.loads(numbers.read_text())
    assert content["kind"] == "vqbet_chunked checkpoint"
    assert content["episodes"] == [0, 2]
    assert content["drift"]["folder"] == other
    assert content["drift"]["error_ratio"] > 1.5
    assert len(content["usage"]["levels"]) == 2
    assert "train the tokenizer and the policy on both" in " ".join(capsys.readouterr().out.split())


def test_a_checkpoint_whose_tokenizer_is_not_done(dataset, tmp_path, capsys):
    checkpoint = write_checkpoint(tmp_path / "policy", dataset=dataset, n_learned=3)
    assert main(["codebook", checkpoint]) == FAILED
    assert "has learned for 3 of 7 steps: resume the training" in " ".join(capsys.readouterr().out.split())


def test_tokenizers_for_a_dataset(dataset, tmp_path, monkeypatch, capsys):
    small = [Candidate({"tokenizer": "uniform", "n_bins": n}) for n in (4, 256)]
    monkeypatch.setattr(measuring, "candidates_for", lambda chunk_size: small)
    numbers, picture = tmp_path / "comparison.json", tmp_path / "comparison.png"
    asked = ["--chunk-size", "5", "--chunk-stride", "2", "--max-lost", "0.01"]
    assert main(["codebook", dataset, *asked, "--json", str(numbers), "--out", str(picture)]) == PASSED
    content = json.loads(numbers.read_text(), parse_constant=pytest.fail)
    assert content["recommended"]["name"] == "uniform 256 bins"
    assert (content["chunk_size"], content["chunk_stride"]) == (5, 2)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert "--policy.tokenizer=uniform --policy.n_bins=256 --policy.chunk_size=5" in capsys.readouterr().out


def refused(arguments, capsys):
    assert main(["codebook", *arguments]) == REFUSED
    return " ".join(capsys.readouterr().err.split())


def test_refuses_what_cannot_work(dataset, tmp_path, capsys):
    file = write_tokenizer(tmp_path / "bins.safetensors", dataset)
    lost = write_tokenizer(tmp_path / "lost.safetensors", str(tmp_path / "gone"))
    three = write_dataset(tmp_path / "three", episodes=1, width=3)
    unknown = write_checkpoint(tmp_path / "policy")
    (tmp_path / "no_tokenizer").write_bytes(b"text")
    cases = [
        ([file, "--dataset", three], "is for 2 action dimensions, the dataset at"),
        ([file, "--dataset", str(tmp_path / "gone")], "there is no dataset at"),
        ([lost], "gone: give a LeRobotDataset's folder (with meta/info.json) as --dataset"),
        ([unknown], "it does not say what it was trained on: give a LeRobotDataset's folder"),
        ([str(tmp_path / "no_tokenizer")], "is not a file of act-chunking train-tokenizer"),
        ([str(tmp_path / "nowhere")], "there is no checkpoint at"),
        ([file, "--chunk-size", "5"], "--chunk-size=5 goes with a dataset"),
        ([dataset, "--dataset", dataset], "goes with a checkpoint or a tokenizer file"),
        ([dataset, "--max-lost", "2"], "max_lost=2.0 must be between 0 and 1"),
        ([dataset, "--chunk-size", "0"], "chunk_size=0 must be at least 1"),
        ([dataset, "--steps", "0"], "steps=0 must be at least 1"),
        ([three], "has 1 episode: it takes 2"),
    ]
    for arguments, message in cases:
        assert message in refused(arguments, capsys), arguments


def test_other_policies_have_no_codebook(tmp_path, capsys):
    act = ACTConfig(
        input_features=dict(INPUTS), output_features=dict(OUTPUTS), device="cpu", push_to_hub=False
    )
    act._save_pretrained(tmp_path)
    message = refused([str(tmp_path)], capsys)
    assert (
        "act has no codebook: give a vqbet_chunked checkpoint, a file of act-chunking train-tokenizer"
        in message
    )
    (tmp_path / "config.json").write_text(json.dumps({"type": "temporal_ensemble", "inner": {"type": "act"}}))
    assert "give the checkpoint it wraps" in refused([str(tmp_path)], capsys)


def test_data_without_the_trainings_episodes_is_refused(dataset, tmp_path, capsys):
    checkpoint = write_checkpoint(tmp_path / "policy", dataset=dataset, episodes=[9])
    assert "has none of the training's episodes" in refused([checkpoint], capsys)


def test_help_explains_both_uses(capsys):
    assert main(["codebook", "--help"]) == PASSED
    printed = " ".join(capsys.readouterr().out.replace("│", "").split())
    assert "which tokenizer suits" in printed
    assert "Exit status: 0 fine or to be looked at" in printed
