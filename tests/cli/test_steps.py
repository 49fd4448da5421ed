"""``act-chunking steps`` as a user meets it."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors

import lerobot_act_chunking.policies.diffusion_chunked.configuration_diffusion_chunked  # noqa: F401  (registers)
from lerobot_act_chunking.cli.main import main

PASSED, REFUSED, UNDECIDED = 0, 1, 10
S, A = 3, 2
INPUTS = {"observation.state": PolicyFeature(FeatureType.STATE, (S,))}
OUTPUTS = {"action": PolicyFeature(FeatureType.ACTION, (A,))}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data") / "waves"
    features = {
        "action": {"dtype": "float32", "shape": (A,), "names": ["reach", "gripper"]},
        "observation.state": {"dtype": "float32", "shape": (S,), "names": None},
    }
    dataset = LeRobotDataset.create("me/waves", fps=20, features=features, root=folder)
    rng = np.random.default_rng(0)
    for _ in range(3):
        for step in range(110):
            action = np.array([np.sin(0.06 * step), step > 60], np.float32)
            state = rng.normal(size=S).astype(np.float32)
            dataset.add_frame({"action": action, "observation.state": state, "task": "wave"})
        dataset.save_episode()
    dataset.finalize()
    return str(folder)


def save_checkpoint(folder, **settings):
    config = PreTrainedConfig.get_choice_class("diffusion_chunked")(
        device="cpu",
        push_to_hub=False,
        horizon=4,
        chunk_stride=2,
        actions_per_token=1,
        dim_model=8,
        n_layers=1,
        use_ema=False,
        input_features=dict(INPUTS),
        output_features=dict(OUTPUTS),
        **settings,
    )
    torch.manual_seed(0)
    policy = get_policy_class("diffusion_chunked")(config)
    for weight in policy.parameters():
        if not weight.any():  # as training would: what is zero still would count as untrained
            torch.nn.init.normal_(weight, std=0.3)
    state = {"mean": torch.zeros(S), "std": torch.ones(S), "min": -torch.ones(S), "max": torch.ones(S)}
    action = {"mean": torch.zeros(A), "std": torch.ones(A), "min": -torch.ones(A), "max": torch.ones(A)}
    stats = {"observation.state": state, "action": action}
    for part in (policy, *make_pre_post_processors(config, dataset_stats=stats)):
        part.save_pretrained(folder)
    return str(folder)


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    return save_checkpoint(tmp_path_factory.mktemp("checkpoint"), num_inference_steps=2)


QUICK = ["--sampler", "euler", "--steps", "2,5", "--episodes", "3"]


def test_whether_few_steps_are_enough(checkpoint, dataset, tmp_path, capsys):
    numbers, picture = tmp_path / "new" / "steps.json", tmp_path / "steps.png"
    outputs = ["--json", str(numbers), "--out", str(picture)]
    asked = ["steps", checkpoint, "--dataset", dataset, "--tolerance", "100", "--seed", "4", *QUICK]
    assert main([*asked, *outputs]) == PASSED
    content = json.loads(numbers.read_text(), parse_constant=pytest.fail)
    assert content["tool"] == "steps"
    assert content["verdict"] in ("pass", "warn")
    assert content["unit"] == "raw units"
    assert content["n_observations"] == 256
    assert content["seed"] == 4
    assert content["seen_in_training"] is False
    assert [(cell["sampler"], cell["n_steps"]) for cell in content["cells"]] == [("euler", 2), ("euler", 5)]
    assert all(cell["ms"] > 0 for cell in content["cells"])
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert "of the chunks against midpoint 100" in capsys.readouterr().out


def test_few_observations_cannot_be_judged(checkpoint, dataset):
    asked = ["--tolerance", "100", "--observations", "3", *QUICK]
    assert main(["steps", checkpoint, "--dataset", dataset, *asked]) == UNDECIDED


def test_success_is_measured_in_any_environment(checkpoint, dataset, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / "diagnostics")
    numbers = tmp_path / "steps.json"
    line = ["--env.discover_packages_path=line_environment", "--env.type=line_of_tests", f"--env.width={S}"]
    asked = ["steps", checkpoint, "--dataset", dataset, "--tolerance", "100", "--observations", "3", *QUICK]
    asked += [*line, "--success-seeds", "4", "--json", str(numbers)]
    rates = {}
    for end in (-9, 9):
        assert main([*asked, f"--env.ends.success={end}"]) == UNDECIDED
        cells = json.loads(numbers.read_text())["success"]
        assert [(cell["n_steps"], cell["episodes"]) for cell in cells] == [(2, 4), (5, 4)]
        rates[end] = [cell["successes"] for cell in cells]
    assert rates == {-9: [4, 4], 9: [0, 0]}


def test_an_environment_that_does_not_fit_is_refused_before_the_sweep(checkpoint, monkeypatch, capsys):
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / "diagnostics")
    line = ["--env.discover_packages_path=line_environment", "--env.type=line_of_tests"]
    asked = ["steps", checkpoint, "--tolerance", "100", *line]  # without a dataset: that is asked for later
    assert main([*asked, f"--env.width={S + 1}"]) == REFUSED
    assert f"trained with {S} numbers of 'observation.state'" in capsys.readouterr().err
    assert main([*asked, f"--env.width={S}", "--env.task=Circle-v0"]) == REFUSED
    assert "LeRobot cannot make the environment line_of_tests" in capsys.readouterr().err


@pytest.mark.parametrize("clip_mode", ["consistent", "lerobot"])
def test_ddpm_is_swept_with_ddim_in_its_place(dataset, clip_mode, tmp_path, capsys):
    policy = save_checkpoint(
        tmp_path / "policy", objective="ddpm", sampler="ddpm", num_inference_steps=4, clip_mode=clip_mode
    )
    numbers = tmp_path / "steps.json"
    asked = ["--tolerance", "100", "--observations", "2", "--steps", "1,4", "--json", str(numbers)]
    assert main(["steps", policy, "--dataset", dataset, *asked]) == UNDECIDED
    content = json.loads(numbers.read_text())
    assert content["own"] == {"sampler": "ddim", "n_steps": 4, "spacing": "leading"}
    cells = [(cell["sampler"], cell["spacing"], cell["n_steps"]) for cell in content["cells"]]
    assert cells == [
        ("ddim", "leading", 4),
        ("ddim", "linspace", 4),
        ("ddim", "trailing", 1),
        ("ddim", "trailing", 4),
        ("dpm++", None, 1),
        ("dpm++", None, 4),
    ]
    assert "the policy samples with ddpm" in " ".join(capsys.readouterr().out.split()).lower()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "so there is no distance in millimetres: say with --tolerance"),
        (["--tolerance", "0"], "tolerance=0.0 must be a positive number"),
        (["--steps", "2,few"], "steps='2,few' must be numbers with commas between them"),
        (["--tolerance", "1", "--sampler", "ddim"], "unknown sampler of flow 'ddim'"),
        (["--tolerance", "1", "--episodes", "0"], "episodes=0 must be at least 1"),
        (["--success", "juggling"], "unknown task 'juggling'"),
        (["--success", "insertion", "--env.type=pusht"], "--success insertion is short for an environment"),
    ],
)
def test_refuses_what_cannot_work(checkpoint, dataset, arguments, message, capsys):
    assert main(["steps", checkpoint, "--dataset", dataset, *arguments]) == REFUSED
    assert message in " ".join(capsys.readouterr().err.split())


def test_says_which_dataset_is_missing(checkpoint, capsys):
    assert main(["steps", checkpoint]) == REFUSED
    assert "give a LeRobotDataset's folder" in " ".join(capsys.readouterr().err.split())


def test_other_policies_have_no_steps(tmp_path, capsys):
    act = ACTConfig(
        input_features=dict(INPUTS), output_features=dict(OUTPUTS), device="cpu", push_to_hub=False
    )
    act._save_pretrained(tmp_path)
    assert main(["steps", str(tmp_path)]) == REFUSED
    message = " ".join(capsys.readouterr().err.split())
    assert "act has no denoising steps to sweep: give a diffusion_chunked checkpoint" in message
    wrapper = {"type": "temporal_ensemble", "inner": {"type": "act"}}
    (tmp_path / "config.json").write_text(json.dumps(wrapper))
    assert main(["steps", str(tmp_path)]) == REFUSED
    assert "takes no steps of its own: give the checkpoint it wraps" in capsys.readouterr().err


def test_help_explains_the_exit_status(capsys):
    assert main(["steps", "--help"]) == PASSED
    printed = " ".join(capsys.readouterr().out.replace("│", "").split())
    assert "Exit status: 0 the policy's steps are enough" in printed
    assert "default: 0.5 mm" in printed


def test_the_files_are_there_even_if_nobody_reads_the_output(checkpoint, dataset, tmp_path, monkeypatch):
    def closed(*_, **__):
        raise BrokenPipeError

    monkeypatch.setattr("lerobot_act_chunking.diagnostics.steps.terminal.print_report", closed)
    numbers = tmp_path / "steps.json"
    asked = ["--tolerance", "1", "--observations", "3", *QUICK, "--json", str(numbers)]
    with pytest.raises(BrokenPipeError):
        main(["steps", checkpoint, "--dataset", dataset, *asked])
    assert json.loads(numbers.read_text())["tool"] == "steps"
