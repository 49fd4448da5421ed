"""``act-chunking tune`` as a user meets it, with untrained policies and episodes of a few steps."""

import json

import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from small_policies import make_policy, save

from lerobot_act_chunking.cli.main import main
from lerobot_act_chunking.diagnostics.core.outcomes import FILE

PASSED, REFUSED, UNDECIDED = 0, 1, 10
SHORT = ["--env.type=aloha_sim", "--env.obs_type=state", "--env.episode_length=3"]
STATE = {"observation.state": PolicyFeature(FeatureType.STATE, (2,))}


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    return save(make_policy(), tmp_path_factory.mktemp("aloha"))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data") / "waves"
    vector = {"dtype": "float32", "shape": (2,), "names": ["reach", "lift"]}
    features = {"action": vector, "observation.state": vector}
    dataset = LeRobotDataset.create("me/waves", fps=20, features=features, root=folder)
    for length in (12, 20, 17):
        for step in range(length):
            at = np.sin(0.3 * step + np.arange(2)).astype(np.float32)
            dataset.add_frame({"action": at, "observation.state": at, "task": "wave"})
        dataset.save_episode()
    dataset.finalize()
    return str(folder)


def test_a_race_of_untrained_policies_is_undecided_and_kept(checkpoint, tmp_path, capsys):
    numbers, picture, kept = tmp_path / "new" / "tune.json", tmp_path / "tune.png", tmp_path / "kept"
    asked = ["tune", checkpoint, *SHORT, "--episodes", "2", "--workers", "1", "--output-dir", str(kept)]
    assert main([*asked, "--json", str(numbers), "--out", str(picture)]) == UNDECIDED
    out = " ".join(capsys.readouterr().out.split())
    assert "there is nothing to choose by" in out
    assert "from 100000 on: evaluate the choice on others" in out
    content = json.loads(numbers.read_text(), parse_constant=pytest.fail)
    assert (content["tool"], content["measured_by"], content["first_seed"]) == ("tune", "success", 100_000)
    assert content["chosen"] == content["present"]
    assert content["flags"] == ""
    assert content["complete"]
    assert all(each["success"]["episodes"] == 2 for each in content["candidates"])
    assert content["n_episodes"] == 2 * len(content["candidates"])
    assert picture.read_bytes().startswith(b"\x89PNG")
    before = (kept / FILE).read_bytes()
    assert main([*asked, "--minutes", "1e-9"]) == UNDECIDED  # all is there: no time is needed
    assert "there is nothing to choose by" in " ".join(capsys.readouterr().out.split())
    assert (kept / FILE).read_bytes() == before


def test_the_options_that_went_are_usage_errors(checkpoint, capsys):
    assert main(["tune", checkpoint, "--env-type", "pusht"]) == 2
    assert "No such option: --env-type" in capsys.readouterr().err


def test_no_time_means_no_choice(checkpoint, tmp_path, capsys):
    asked = ["--task", "transfer_cube", "--minutes", "1e-9", "--workers", "1", "--output-dir", str(tmp_path)]
    assert main(["tune", checkpoint, *asked]) == UNDECIDED
    assert "candidates were tried: run the same command again" in " ".join(capsys.readouterr().out.split())


def test_replay_without_an_environment(dataset, tmp_path, capsys):
    policy = save(make_policy(inputs=STATE, start=torch.zeros(2)), tmp_path / "policy")
    numbers, picture = tmp_path / "tune.json", tmp_path / "tune.png"
    asked = ["tune", policy, "--dataset", dataset, "--episodes", "2", "--json", str(numbers)]
    assert main([*asked, "--out", str(picture)]) == PASSED
    out = " ".join(capsys.readouterr().out.split())
    assert "a policy that stalls or drifts looks good in it" in out
    content = json.loads(numbers.read_text(), parse_constant=pytest.fail)
    assert (content["measured_by"], content["verdict"], content["seen_in_training"]) == (
        "replay",
        "warn",
        False,
    )
    assert all(each["replay"]["distance"] > 0 for each in content["candidates"])
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "tune measures in an environment or by a dataset, got none: give --task"),
        (["--task", "insertion", "--dataset", "x"], "got both: give --task"),
        (["--task", "juggle"], "unknown task 'juggle'; choose one of"),
        (["--env.type=moon"], "unknown environment type 'moon'; choose one of"),
        ([*SHORT, "--env.obs_tpye=state"], "aloha_sim has no --env.obs_tpye; did you mean --env.obs_type?"),
        (["--task", "insertion", "--env.success=hold"], "--task insertion is short for an environment"),
        (["--dataset", "./nowhere"], "there is no dataset at"),
        (["--dataset", "x", "--success", "hold"], "--success=hold is a rule of the tasks of --task"),
        (["--task", "insertion", "--episodes", "0"], "episodes=0 must be at least 1"),
        (["--task", "insertion", "--minutes", "0"], "minutes=0.0 must be a positive number"),
        (["--task", "FetchPush-v4"], "trained with"),
    ],
)
def test_wrong_questions_are_refused_in_one_line(arguments, message, checkpoint, capsys):
    assert main(["tune", checkpoint, *arguments]) == REFUSED
    assert message in " ".join(capsys.readouterr().err.split())
