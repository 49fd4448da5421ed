"""``act-chunking latent`` and ``fit-prior`` as a user meets them."""

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from safetensors.torch import load_file, save_file

import lerobot_act_chunking.policies.act_chunked.configuration_act_chunked  # noqa: F401  (registers)
from lerobot_act_chunking.cli.main import main
from lerobot_act_chunking.policies.loading import load_policy

DONE, FAILED, REFUSED = 0, 11, 1
S, A, C, L = 3, 2, 6, 4


def write_dataset(folder, *, width=A):
    """Waves whose height differs between episodes: something for a latent to tell."""
    features = {
        "action": {"dtype": "float32", "shape": (width,), "names": [f"joint_{i}" for i in range(width)]},
        "observation.state": {"dtype": "float32", "shape": (S,), "names": None},
    }
    dataset = LeRobotDataset.create("me/waves", fps=20, features=features, root=folder)
    for episode in range(4):
        for step in range(40):
            action = (-1) ** episode * np.sin(0.3 * step + np.arange(width))
            state = np.full(S, step / 20 - 1, np.float32)
            dataset.add_frame({"action": action.astype(np.float32), "observation.state": state, "task": "w"})
        dataset.save_episode()
    dataset.finalize()
    return str(folder)


def write_checkpoint(folder, **settings):
    sizes = {"dim_model": 16, "n_heads": 2, "dim_feedforward": 24, "n_encoder_layers": 1, "latent_dim": L}
    config = PreTrainedConfig.get_choice_class("act_chunked")(
        device="cpu",
        push_to_hub=False,
        chunk_size=C,
        input_features={"observation.state": PolicyFeature(FeatureType.STATE, (S,))},
        output_features={"action": PolicyFeature(FeatureType.ACTION, (A,))},
        **{**sizes, "use_vae": True, "use_ema": True, "dropout": 0.0, **settings},
    )
    torch.manual_seed(0)
    policy = get_policy_class("act_chunked")(config)
    stats = {key: {"mean": torch.zeros(n), "std": torch.ones(n)} for key, n in (("action", A),)}
    stats["observation.state"] = {"mean": torch.zeros(S), "std": torch.ones(S)}
    for part in (policy, *make_pre_post_processors(config, dataset_stats=stats)):
        part.save_pretrained(folder)
    (folder / "train_config.json").write_text('{"dataset": {"root": "somewhere"}}')
    return str(folder)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return write_dataset(tmp_path_factory.mktemp("data") / "waves")


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    return write_checkpoint(tmp_path_factory.mktemp("policies") / "gaussian")


def digests(folder):
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in folder.iterdir()}


def test_an_untrained_latent_is_diagnosed(dataset, checkpoint, tmp_path, capsys):
    numbers, picture = tmp_path / "new" / "latent.json", tmp_path / "latent.png"
    assert main(["latent", checkpoint, dataset, "--json", str(numbers), "--out", str(picture)]) == DONE
    content = json.loads(numbers.read_text(), parse_constant=pytest.fail)
    assert content["diagnosis"] == "posterior collapse"
    assert content["n_samples"] == 160
    assert len(content["kl_by_dimension"]) == L
    assert content["kl"] == pytest.approx(sum(content["kl_by_dimension"]))
    assert set(content["reconstruction_error"]) == {
        "posterior",
        "shuffled",
        "mode",
        "N(0, I)",
        "fitted density",
    }
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert "zero, the mode *" in capsys.readouterr().out


def test_a_latent_that_has_hardly_learned_says_so_before_the_diagnosis(dataset, checkpoint, tmp_path, capsys):
    def reasons(change):
        content = load_file(weights)
        save_file({name: change(name, tensor) for name, tensor in content.items()}, weights)
        main(["latent", str(folder), dataset, "--json", str(tmp_path / "latent.json")])
        return json.loads((tmp_path / "latent.json").read_text())["reasons"]

    folder = Path(shutil.copytree(checkpoint, tmp_path / "policy"))
    weights = folder / "model.safetensors"
    untouched = reasons(lambda _, tensor: tensor)
    assert "is untrained" in untouched[0]
    one_step = reasons(lambda name, tensor: tensor * 1.01 if name.endswith("weight") else tensor)
    assert "has hardly learned: on the demonstrations it is off by" in one_step[0]
    assert "train for longer" in one_step[0]
    assert "policy acts as one without a latent" in one_step[1]
    assert one_step[0] in " ".join(capsys.readouterr().out.split())


def test_a_fitted_prior_is_a_checkpoint_of_its_own(dataset, checkpoint, tmp_path, capsys):
    before, out = digests(Path(checkpoint)), tmp_path / "fitted"
    arguments = ["fit-prior", checkpoint, dataset, "--out", str(out), "--component-weights", "uniform"]
    assert main(arguments) == DONE
    assert f"checkpoint: {out}" in capsys.readouterr().out.replace("\n", "")
    assert digests(Path(checkpoint)) == before
    assert set(digests(out)) == set(before)
    assert (out / "train_config.json").read_bytes() == (Path(checkpoint) / "train_config.json").read_bytes()
    fitted, given = load_policy(out).policy, load_policy(checkpoint).policy
    assert (fitted.config.z_inference, fitted.config.prior_component_weights) == ("sample", "uniform")
    for network, original in ((fitted.model, given.model), (fitted.ema.network, given.ema.network)):
        assert network.latent.fitted
        assert network.latent.weights.sum() == pytest.approx(1.0)
        assert not original.latent.fitted
        for mine, theirs in zip(network.parameters(), original.parameters(), strict=True):
            assert torch.equal(mine, theirs)
    chunk = fitted.predict_action_chunk({"observation.state": torch.zeros(2, S)})
    assert not torch.equal(chunk[0], chunk[1])
    assert main(["latent", str(out), dataset]) == DONE
    assert "sample of the fitted density *" in capsys.readouterr().out


@pytest.mark.parametrize("latent_type", ["conditional", "mixture", "categorical"])
def test_other_latents_are_diagnosed_and_not_fitted(latent_type, dataset, tmp_path, capsys):
    checkpoint = write_checkpoint(tmp_path / "policy", latent_type=latent_type, z_inference="sample")
    picture, out = tmp_path / "latent.png", tmp_path / "fitted"
    assert main(["latent", checkpoint, dataset, "--out", str(picture)]) in (DONE, FAILED)
    assert "sample of the prior *" in capsys.readouterr().out
    assert picture.exists()
    assert main(["fit-prior", checkpoint, dataset, "--out", str(out)]) == REFUSED
    assert f"latent_type={latent_type} learns its prior" in capsys.readouterr().err
    assert not out.exists()


def test_a_run_that_breaks_off_leaves_nothing(dataset, checkpoint, tmp_path, monkeypatch):
    from lerobot_act_chunking import durable_files

    def break_off(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(durable_files, "publish", break_off)
    assert main(["fit-prior", checkpoint, dataset, "--out", str(tmp_path / "out" / "fitted")]) == 130
    assert list((tmp_path / "out").iterdir()) == []


def refusal(capsys, *arguments):
    assert main([str(each) for each in arguments]) == REFUSED
    return " ".join(capsys.readouterr().err.split())


def test_refusals(dataset, checkpoint, tmp_path, capsys):
    assert "exists already" in refusal(capsys, "fit-prior", checkpoint, dataset, "--out", tmp_path)
    assert "there is no dataset at" in refusal(capsys, "latent", checkpoint, tmp_path / "none")
    assert "there is no checkpoint at" in refusal(capsys, "latent", tmp_path / "none", dataset)
    assert "samples=1 must be at least 2" in refusal(capsys, "latent", checkpoint, dataset, "--samples", 1)
    out = tmp_path / "fitted"
    told = refusal(capsys, "fit-prior", checkpoint, dataset, "--out", out, "--component-weights", "even")
    assert "unknown component_weights 'even'; choose one of: empirical, uniform" in told
    assert not out.exists()
    plain = write_checkpoint(tmp_path / "plain", use_vae=False)
    assert "trained without a latent" in refusal(capsys, "latent", plain, dataset)


def test_a_dataset_of_another_robot(checkpoint, tmp_path, capsys):
    other = write_dataset(tmp_path / "other", width=5)
    told = refusal(capsys, "latent", checkpoint, other)
    assert "trained with 2 numbers of 'action', the dataset at" in told
    assert "has 5 numbers: give a dataset of the same robot" in told
