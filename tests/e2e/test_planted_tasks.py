"""The tasks with several ways in LeRobot's own commands: recorded, trained on, evaluated."""

import json
import sys

import pytest
from lerobot.scripts import lerobot_eval, lerobot_train
from policy_cases import MODULES, TYPES

from lerobot_act_chunking.cli.main import main

TRAINED = (
    f"--policy.type={TYPES[0]} {MODULES[TYPES[0]].TRAINED} --policy.device=cpu --policy.push_to_hub=false"
)
SMALL = "--env.render_quality=fast --env.visualization_height=48 --env.visualization_width=64"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("recorded", "environment"),
    [
        ("--env three_gates --mode-shares 34,33,33", "--env.type=three_gates"),
        (
            "--env so_arm_sim --task two_ways --mode-shares 34,66",
            "--env.type=so_arm_sim --env.task=two_ways",
        ),
        (
            "--task transfer_modes --mode-shares 34,33,33",
            "--env.type=aloha_sim --env.task=transfer_modes --env.obs_type=state",
        ),
    ],
)
def test_recorded_trained_and_evaluated(recorded, environment, monkeypatch, tmp_path):
    def run(command, *words):
        monkeypatch.setattr(sys, "argv", ["lerobot", *" ".join(words).split()])
        command()

    data, trained, evaluated = tmp_path / "data", tmp_path / "run", tmp_path / "eval"
    asked = f"record {recorded} --episodes 3 --repo-id test/ways --root {data}"
    assert main(asked.split()) == 0
    dataset = f"--dataset.repo_id=test/ways --dataset.root={data} --batch_size=3 --num_workers=0"
    run(lerobot_train.main, TRAINED, dataset, f"--steps=2 --save_freq=2 --output_dir={trained}")
    policy = f"--policy.path={trained / 'checkpoints' / 'last' / 'pretrained_model'} --policy.device=cpu"
    episodes = "--env.episode_length=6 --eval.n_episodes=2 --eval.batch_size=2 --eval.use_async_envs=false"
    run(lerobot_eval.main, policy, environment, SMALL, episodes, f"--output_dir={evaluated}")
    overall = json.loads((evaluated / "eval_info.json").read_text())["overall"]
    assert overall["n_episodes"] == 2
    assert len(overall["video_paths"]) == 2
