"""LeRobot's own training command: it runs, and a resumed run is the undisturbed one."""

import json

import pytest
from policy_cases import LENGTHS, TYPES
from safetensors.torch import load_file
from tiers import some
from training_runs import fresh, record, weights

from lerobot_act_chunking.errors import DatasetError

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("policy_type", TYPES)
def test_a_resumed_run_is_the_undisturbed_one(train, dataset, tmp_path, policy_type):
    train(*fresh(dataset, tmp_path / "whole", "--steps=4", policy_type=policy_type))
    config = tmp_path / "whole" / "checkpoints" / "000002" / "pretrained_model" / "train_config.json"
    train(f"--config_path={config}", "--resume=true", f"--output_dir={tmp_path / 'resumed'}")
    whole, resumed = weights(tmp_path / "whole", "000004"), weights(tmp_path / "resumed", "000004")
    assert whole.keys() == resumed.keys()
    for name, value in whole.items():
        assert value.equal(resumed[name]), name


def saved(run):
    return json.loads((run / "checkpoints/last/pretrained_model/config.json").read_text())


@pytest.mark.parametrize(("policy_type", "name"), LENGTHS.items())
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


@pytest.mark.parametrize(("policy_type", "name"), some(1, LENGTHS.items()))
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


def test_a_nan_in_the_dataset_is_refused(train, tmp_path):
    spoiled = record(tmp_path / "dataset", spoiled="observation.state")
    with pytest.raises(DatasetError, match=r"observation\.state"):
        train(*fresh(spoiled, tmp_path / "run"))


def test_fine_tuning_starts_from_the_checkpoint(train, dataset, tmp_path):
    train(*fresh(dataset, tmp_path / "first", "--steps=2", "--policy.use_ema=true"))
    checkpoint = tmp_path / "first" / "checkpoints" / "last" / "pretrained_model"
    arguments = [argument for argument in fresh(dataset, tmp_path / "second") if "--policy." not in argument]
    train(*arguments, f"--policy.path={checkpoint}", "--policy.push_to_hub=false", "--steps=2")
    second = load_file(
        tmp_path / "second" / "checkpoints" / "last" / "pretrained_model" / "model.safetensors"
    )
    assert second["ema.step"] == 4
