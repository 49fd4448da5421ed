"""``act-chunking train-tokenizer`` as a user meets it."""

import numpy as np
import pytest
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from lerobot_act_chunking.cli.main import main
from lerobot_act_chunking.cli.running import STOPPED
from lerobot_act_chunking.policies.vqbet_chunked import tokenizer_training
from lerobot_act_chunking.policies.vqbet_chunked.tokenizer_file import read_info

DONE, REFUSED = 0, 1
SMALL = ["--chunk-size", "4", "--vqvae-enc-hidden-dim", "8", "--vqvae-n-embed", "3", "--batch-size", "9"]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data") / "waves"
    features = {"action": {"dtype": "float32", "shape": (2,), "names": ["reach", "gripper"]}}
    dataset = LeRobotDataset.create("me/waves", fps=20, features=features, root=folder)
    for episode in range(2):
        for step in range(12):
            action = np.array([np.sin(0.3 * step + episode), step > 6], np.float32)
            dataset.add_frame({"action": action, "task": "wave"})
        dataset.save_episode()
    dataset.finalize()
    return str(folder)


@pytest.fixture(autouse=True)
def wide_terminal(monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")


def run(dataset, output, *arguments, steps=3):
    return main(["train-tokenizer", dataset, "--out", str(output), "--steps", str(steps), *SMALL, *arguments])


def test_trains_and_tells(dataset, tmp_path, capsys):
    output = tmp_path / "t.safetensors"
    assert run(dataset, output, "--vqvae-coder", "conv", "--no-rotation-trick") == DONE
    text = capsys.readouterr().out
    for part in ("3/3", "reach", "gripper", "level 2", f"--policy.tokenizer_path={output}", "for 24 chunks"):
        assert part in text
    spec = read_info(output).spec
    assert (spec.vqvae_coder, spec.rotation_trick, spec.vqvae_n_embed) == ("conv", False, 3)


def test_ctrl_c_and_the_same_command_again(dataset, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(tokenizer_training, "SAVE_EVERY_S", -1.0)
    step, output = tokenizer_training._Training._step, tmp_path / "t.safetensors"

    def stop_at_third(self, chunks):
        if self.done == 2:
            raise KeyboardInterrupt
        return step(self, chunks)

    with monkeypatch.context() as patched:
        patched.setattr(tokenizer_training._Training, "_step", stop_at_third)
        assert run(dataset, output) == STOPPED
    assert "stopped; run the same command again to go on from here" in capsys.readouterr().err
    assert not output.exists()
    assert run(dataset, output) == DONE
    assert "went on from step 2" in capsys.readouterr().out
    assert run(dataset, output) == DONE
    assert "is there already, made with these settings" in capsys.readouterr().out


def test_refusals(dataset, tmp_path, capsys):
    def refused(*arguments):
        assert run(dataset, tmp_path / "t", *arguments) == REFUSED
        return " ".join(capsys.readouterr().err.split())

    assert "fsq_levels='8;5' must be numbers with commas between them: 8,5,5" in refused(
        "--fsq-levels", "8;5"
    )
    assert "tokenizer=uniform has nothing to learn" in refused("--tokenizer", "uniform")
    assert not list(tmp_path.iterdir())


def test_other_settings_for_the_same_file(dataset, tmp_path, capsys):
    output = tmp_path / "t"
    assert run(dataset, output, "--tokenizer", "fsq", "--fsq-levels", "3,4", steps=1) == DONE
    assert read_info(output).spec.fsq_levels == (3, 4)
    assert run(dataset, output, "--tokenizer", "fsq", "--fsq-levels", "3,5", steps=1) == REFUSED
    assert "was made with fsq_levels (3, 4) (now (3, 5))" in " ".join(capsys.readouterr().err.split())
