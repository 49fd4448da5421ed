"""What instruments know of a checkpoint: whether it was trained, at which rate, and what it fits."""

import json

import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from small_policies import STATE, make_policy, save

from lerobot_act_chunking.cli.main import main
from lerobot_act_chunking.diagnostics.core.environments import environment_of, task_environment
from lerobot_act_chunking.diagnostics.core.report import Judgement, with_untrained
from lerobot_act_chunking.diagnostics.core.training import hardly_learned, read_training, untrained
from lerobot_act_chunking.errors import ConfigurationError, FeatureError

CUBE = task_environment("transfer_cube")
OTHER = {"observation.state": PolicyFeature(FeatureType.STATE, (9,))}


def trained(policy):
    """One step in a direction that changes every weight a little."""
    with torch.no_grad():
        for weight in policy.policy.parameters():
            weight.add_(1e-4 * torch.ones_like(weight))
    return policy


@pytest.mark.parametrize("change", [lambda policy: policy, trained])
def test_untrained_weights_are_told_from_trained_ones(tmp_path, change):
    policy = change(make_policy())
    told = untrained(save(policy, tmp_path / "policy"))
    assert (told is None) == (change is trained)
    assert told is None or "is untrained" in told
    assert untrained("someone/policy") is None


def test_a_denoiser_without_normalisation_is_told_by_its_zeros(tmp_path):
    from safetensors.torch import save_file

    for name, weight in (("fresh", torch.zeros(3, 4)), ("learnt", torch.full((3, 4), 0.1))):
        folder = tmp_path / name
        folder.mkdir()
        save_file({"last.weight": weight, "first.weight": torch.ones(4, 5)}, folder / "model.safetensors")
        assert (untrained(str(folder)) is None) == (name == "learnt")


def test_a_policy_that_knows_the_mean_action_alone_has_hardly_learned():
    message = hardly_learned("me/act", 0.7, 0.8)
    assert message is not None
    assert "me/act has hardly learned: on the demonstrations it is off by 0.7" in message
    assert hardly_learned("me/act", 0.2, 0.8) is None


def test_an_untrained_policy_passes_nothing_and_it_is_said_first():
    fine, bad = Judgement("pass", ["fine"]), Judgement("fail", ["bad"])
    assert with_untrained(fine, None) == fine
    assert with_untrained(fine, "untrained") == Judgement("warn", ["untrained", "fine"])
    assert with_untrained(bad, "untrained") == Judgement("fail", ["untrained", "bad"])


@pytest.mark.parametrize("command", ["motion", "smoothness"])
def test_another_robot_s_policy_is_refused_by_its_sizes(tmp_path, capsys, command):
    path = save(make_policy(inputs=OTHER, start=torch.zeros(5)), tmp_path / "policy")
    assert main([command, path]) == 1
    told = capsys.readouterr().err
    assert (
        "trained with 9 numbers of 'observation.state', the environment transfer_cube has 14 numbers" in told
    )


def test_a_missing_observation_and_another_rate_are_named(tmp_path):
    strange = {**STATE, "observation.force": PolicyFeature(FeatureType.STATE, (3,))}
    policy = make_policy(inputs=strange)
    with pytest.raises(
        FeatureError, match=r"needs 'observation\.force', but the environment transfer_cube has "
    ):
        environment_of(policy.policy.config, CUBE)
    slow = make_policy(fps=30)
    with pytest.raises(
        FeatureError, match=r"trained at 30 control steps a second, the environment .* runs at 50"
    ):
        environment_of(slow.policy.config, CUBE)
    assert environment_of(make_policy(fps=50).policy.config, CUBE).fps == 50


def test_the_rate_is_that_of_the_training_data(tmp_path):
    data = tmp_path / "data"
    (data / "meta").mkdir(parents=True)
    (data / "meta" / "info.json").write_text(json.dumps({"fps": 30}))
    path = save(make_policy(), tmp_path / "policy")
    assert read_training(path).fps is None
    training = {"dataset": {"root": str(data), "repo_id": "me/data", "episodes": [2]}}
    (tmp_path / "policy" / "train_config.json").write_text(json.dumps(training))
    found = read_training(path)
    assert (found.folder, found.episodes, found.fps) == (str(data), [2], 30)
    (tmp_path / "policy" / "train_config.json").write_text("[]")
    with pytest.raises(ConfigurationError, match="no training configuration"):
        read_training(path)


def test_bandwidth_is_told_at_the_rate_of_the_training(tmp_path, capsys):
    path = save(make_policy(fps=30), tmp_path / "policy")
    assert main(["bandwidth", path, "--json", str(tmp_path / "found.json")]) == 0
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["fps"] == 30
    assert "untrained" in found["reasons"][-1]
    unknown = save(make_policy(), tmp_path / "unknown")
    assert main(["bandwidth", unknown, "--json", str(tmp_path / "found.json")]) == 0
    assert "does not tell its control rate" in json.loads((tmp_path / "found.json").read_text())["notes"][0]
    capsys.readouterr()
