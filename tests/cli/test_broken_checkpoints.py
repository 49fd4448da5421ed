"""Whatever is damaged in a checkpoint, a command ends with one line that says what."""

import json
import random
import shutil

import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from tiers import draws

import lerobot_act_chunking.plugin  # noqa: F401  (registers the policies)
from lerobot_act_chunking.cli.main import app, main
from lerobot_act_chunking.cli.running import REFUSED

S, E, A = 6, 7, 4
INPUTS = {
    "observation.state": PolicyFeature(FeatureType.STATE, (S,)),
    "observation.environment_state": PolicyFeature(FeatureType.ENV, (E,)),
}
OUTPUTS = {"action": PolicyFeature(FeatureType.ACTION, (A,))}
TRANSFORMER = {"dim_model": 16, "n_heads": 2, "dim_feedforward": 24, "n_encoder_layers": 1, "chunk_size": 5}
SETTINGS = {
    "act": {**TRANSFORMER, "n_action_steps": 5, "use_vae": False},
    "act_chunked": {**TRANSFORMER, "n_vae_encoder_layers": 1, "use_vae": True},
    "diffusion_chunked": {"horizon": 4, "actions_per_token": 1, "dim_model": 8, "n_layers": 1},
    "vqbet_chunked": {"chunk_size": 5, "gpt_hidden_dim": 16, "gpt_n_layer": 1, "gpt_n_head": 2},
}
COMMANDS = {
    "wrap {} --out {}/wrapped": "act",
    "motion {} --out {}/motion.png": "act",
    "smoothness {} --episodes 2": "act",
    "bandwidth {}": "act",
    "bandwidth {} --env transfer_cube": "act",
    "import {} --out {}/imported": "act",
    "latent {} {}/dataset": "act_chunked",
    "fit-prior {} {}/dataset --out {}/fitted": "act_chunked",
    "steps {} --dataset {}/dataset": "diffusion_chunked",
    "codebook {}": "vqbet_chunked",
}
KNOWN = {command.name for command in app.registered_commands}
COMMANDS = {command: policy for command, policy in COMMANDS.items() if command.split()[0] in KNOWN}
SETTINGS = {policy: settings for policy, settings in SETTINGS.items() if policy in COMMANDS.values()}
READS_SETTINGS_ALONE = "bandwidth {}"
FITS_NO_WEIGHTS = "features of another size"
CONFIG, WEIGHTS = "config.json", "model.safetensors"
BEFORE, AFTER = "policy_preprocessor.json", "policy_postprocessor.json"


def remove(path):
    path.unlink()


def truncate(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def empty(path):
    path.write_bytes(b"")


def scramble(path):
    path.write_bytes(b"\x00\xff not what it was \x80" * 9)


def make_folder(path):
    path.unlink()
    path.mkdir()


def list_in_place(path):
    path.write_text("[1, 2]")


def nested(path):
    path.write_text("[" * 100_000)


def edit(**changes):
    def change(path):
        content = json.loads(path.read_text())
        for name, value in changes.items():
            if value is None:
                content.pop(name)
            else:
                content[name] = value
        path.write_text(json.dumps(content))

    return change


ANY = {each.__name__: each for each in (remove, truncate, empty, scramble, make_folder)}
JSON = ANY | {each.__name__: each for each in (list_in_place, nested)}
DAMAGES = {
    CONFIG: JSON
    | {
        "no type": edit(type=None),
        "unknown type": edit(type="telepathy"),
        "unknown field": edit(arms=3),
        "text for a number": edit(device="cpu", n_obs_steps="many"),
        "features that are none": edit(input_features={"observation.state": 7}),
        FITS_NO_WEIGHTS: edit(input_features={"observation.state": {"type": "STATE", "shape": [S + 1]}}),
    },
    WEIGHTS: ANY,
    BEFORE: JSON | {"no steps": edit(steps=None), "steps of nothing": edit(steps=[{}])},
    AFTER: JSON | {"an unknown step": edit(steps=[{"registry_name": "magic", "config": {}}])},
    "policy_preprocessor_step_3_normalizer_processor.safetensors": ANY,
}
CASES = [
    (command, file, damage) for command in COMMANDS for file, damages in DAMAGES.items() for damage in damages
]
CHOSEN = random.Random(0).sample(CASES, min(len(CASES), draws(20, len(CASES))))


@pytest.fixture(scope="module")
def checkpoints(tmp_path_factory):
    """An intact checkpoint of every type that a command wants."""
    folders = {}
    for name, settings in SETTINGS.items():
        folders[name] = tmp_path_factory.mktemp("intact") / name
        config = PreTrainedConfig.get_choice_class(name)(
            device="cpu", push_to_hub=False, input_features=INPUTS, output_features=OUTPUTS, **settings
        )
        stats = {
            key: {"mean": torch.zeros(n), "std": torch.ones(n), "min": -torch.ones(n), "max": torch.ones(n)}
            for key, n in (("observation.state", S), ("observation.environment_state", E), ("action", A))
        }
        processors = make_pre_post_processors(config, dataset_stats=stats)
        for part in (get_policy_class(name)(config), *processors):
            part.save_pretrained(folders[name])
    return folders


@pytest.mark.parametrize(("command", "file", "damage"), CHOSEN)
def test_a_damaged_checkpoint_is_one_line(command, file, damage, checkpoints, tmp_path, capsys):
    folder = tmp_path / "pretrained_model"
    shutil.copytree(checkpoints[COMMANDS[command]], folder)
    found = folder / file
    if not found.exists():
        (found,) = folder.glob(f"{file.split('_step_')[0]}_step_*_normalizer_processor.safetensors")
    DAMAGES[file][damage](found)
    status = main([part.format(folder if part == "{}" else tmp_path) for part in command.split()])
    if command == READS_SETTINGS_ALONE and (file != CONFIG or damage == FITS_NO_WEIGHTS):
        assert status == 0
    else:
        assert status == REFUSED
        told = capsys.readouterr().err.strip().splitlines()
        told = [line for line in told if line.startswith("error: ")]
        assert len(told) == 1
        assert len(told[0]) < 1000
    assert {path.name for path in tmp_path.iterdir()} == {"pretrained_model"}


@pytest.mark.skipif("import" not in KNOWN, reason="the way to processors is to import the checkpoint")
@pytest.mark.parametrize("command", [name for name, wanted in COMMANDS.items() if wanted == "act"][:3])
def test_without_processors_the_way_to_them_is_named_and_works(command, checkpoints, tmp_path, capsys):
    folder = tmp_path / "pretrained_model"
    shutil.copytree(checkpoints["act"], folder)
    for file in folder.glob("policy_p*"):
        file.unlink()
    argv = [part.format(folder if part == "{}" else tmp_path) for part in command.split()]
    assert main(argv) == REFUSED
    told = capsys.readouterr().err
    advice = f"act-chunking import {folder} --out <folder> --dataset <the dataset it was trained on>"
    assert f"holds no {BEFORE}; " in told
    assert advice in told
    assert main(["import", str(folder), "--out", str(tmp_path / "imported")]) == REFUSED
    assert "--dataset" in capsys.readouterr().err


def test_a_repository_that_is_not_here_is_one_line(monkeypatch, capsys):
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    for command in COMMANDS:
        argv = [part.format("nobody/nothing" if part == "{}" else "nowhere") for part in command.split()]
        assert main(argv) == REFUSED
        (told,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error: ")]
        assert "nobody/nothing" in told
