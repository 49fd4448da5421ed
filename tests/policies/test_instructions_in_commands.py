"""Instructions through LeRobot's commands: training, evaluation, the engine of ``lerobot-rollout``."""

import json
import sys

import numpy as np
import pytest
import torch
from fake_robot import JOINTS, FakeRobot
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.datasets.dataset_tools import merge_datasets
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.factory import make_pre_post_processors
from lerobot.rollout.inference.factory import SyncInferenceConfig, create_inference_engine
from lerobot.rollout.robot_wrapper import ThreadSafeRobot
from lerobot.scripts import lerobot_eval
from lerobot.utils.feature_utils import build_dataset_frame, hw_to_dataset_features
from policy_cases import SIZES
from tiny_encoder import LEFT, RIGHT, tiny_encoder
from training_runs import fresh

from lerobot_act_chunking.errors import ConfigurationError, DatasetError
from lerobot_act_chunking.policies.act_chunked.configuration_act_chunked import ActChunkedConfig
from lerobot_act_chunking.policies.act_chunked.modeling_act_chunked import ActChunkedPolicy

SIZE_OF = {"observation.state": 14, "observation.environment_state": 21, "action": 14}


@pytest.fixture(scope="module")
def encoder(tmp_path_factory):
    return tiny_encoder(tmp_path_factory.mktemp("language") / "encoder")


def record(root, task):
    """Two short episodes in the shapes of language_transfer."""
    features = {key: {"dtype": "float32", "shape": (n,), "names": None} for key, n in SIZE_OF.items()}
    dataset = LeRobotDataset.create("test/toy", fps=50, features=features, root=root, use_videos=False)
    generator = np.random.default_rng(0)
    for _ in range(2):
        for _ in range(12):
            numbers = {key: generator.normal(size=n).astype(np.float32) for key, n in SIZE_OF.items()}
            dataset.add_frame({**numbers, "task": task})
        dataset.save_episode()
    dataset.finalize()
    return LeRobotDataset("test/toy", root=root)


def test_two_tasks_are_merged_learned_and_evaluated(train, encoder, tmp_path, monkeypatch, capsys):
    parts = [record(tmp_path / name, task) for name, task in (("one", LEFT), ("two", RIGHT))]
    merge_datasets(parts, output_repo_id="test/toy", output_dir=tmp_path / "both")
    output = tmp_path / "run"
    reads = f"--policy.language_encoder={encoder}"
    cut = "--policy.language_tokens=20"
    train(*fresh(tmp_path / "both", output, "--steps=2", reads, cut, policy_type="act_chunked"))
    path = output / "checkpoints" / "last" / "pretrained_model"
    assert json.loads((path / "config.json").read_text())["instructions"]["tasks"] == [LEFT, RIGHT]
    steps = json.loads((path / "policy_preprocessor.json").read_text())["steps"]
    (reading,) = [each for each in steps if each["registry_name"] == "act_chunking_instruction_tokens"]
    assert reading["config"] == {"encoder": encoder, "max_tokens": 20}

    env = "--env.type=aloha_sim --env.task=language_transfer --env.instructions=unseen --env.episode_length=3"
    sizes = "--eval.n_episodes=2 --eval.batch_size=2 --eval.use_async_envs=false --policy.device=cpu"
    film = "--env.render_quality=fast --env.visualization_height=48 --env.visualization_width=64"
    command = f"lerobot-eval --policy.path={path} {env} {sizes} {film} --output_dir={tmp_path / 'eval'}"
    monkeypatch.setattr(sys, "argv", command.split())
    lerobot_eval.main()
    assert json.loads((tmp_path / "eval" / "eval_info.json").read_text())["overall"]["n_episodes"] == 2
    assert "".join(capsys.readouterr()).count("was not among the 2 of the training") == 1


def test_training_refuses_a_dataset_with_an_empty_task(train, encoder, tmp_path):
    record(tmp_path / "data", "")
    reads = f"--policy.language_encoder={encoder}"
    with pytest.raises(DatasetError, match="has an empty task: write one with lerobot-edit-dataset"):
        train(*fresh(tmp_path / "data", tmp_path / "run", "--steps=1", reads, policy_type="act_chunked"))


def test_a_robot_is_told_its_task_and_asked_for_one_that_is_missing(encoder):
    shape = (len(JOINTS),)
    features = hw_to_dataset_features(FakeRobot.observation_features, "observation")
    features |= hw_to_dataset_features(FakeRobot.action_features, "action")
    torch.manual_seed(0)
    config = ActChunkedConfig(
        input_features={"observation.state": PolicyFeature(FeatureType.STATE, shape)},
        output_features={"action": PolicyFeature(FeatureType.ACTION, shape)},
        device="cpu",
        push_to_hub=False,
        language_encoder=encoder,
        language_tokens=16,
        **SIZES["act_chunked"],
    )
    stats = {
        key: {"mean": torch.zeros(shape), "std": torch.ones(shape)} for key in ("action", "observation.state")
    }
    policy, robot = ActChunkedPolicy(config).eval(), FakeRobot(1.0)
    before, behind = make_pre_post_processors(config, dataset_stats=stats)
    done = {}
    for task in (LEFT, RIGHT, LEFT, ""):
        engine = create_inference_engine(
            SyncInferenceConfig(),
            policy=policy,
            preprocessor=before,
            postprocessor=behind,
            robot_wrapper=ThreadSafeRobot(robot),
            hw_features=features,
            dataset_features=features,
            ordered_action_keys=list(JOINTS),
            task=task,
            fps=50,
            device="cpu",
        )
        engine.reset()
        frame = build_dataset_frame(features, robot.get_observation(), "observation")
        if task:
            action = engine.get_action(frame)
            assert torch.equal(action, done.setdefault(task, action))
    assert not torch.equal(done[LEFT], done[RIGHT])
    with pytest.raises(ConfigurationError, match="lerobot-rollout --task"):
        engine.get_action(frame)
