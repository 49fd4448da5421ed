"""gymnasium-robotics' worlds in LeRobot's own commands and in its count of successes."""

import json
import sys
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.envs.factory import make_env
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from lerobot.scripts import lerobot_eval, lerobot_train
from policy_cases import MODULES, TYPES, any_config
from tiers import some

import lerobot_act_chunking.plugin  # noqa: F401  (register)
from lerobot_act_chunking.cli.main import main
from lerobot_act_chunking.envs.configuration_robotics import RoboticsEnvConfig
from lerobot_act_chunking.envs.demonstration import ExpertOptions
from lerobot_act_chunking.envs.robotics.options import RoboticsOptions
from lerobot_act_chunking.errors import FeatureError
from lerobot_act_chunking.recording.recorder import Target, record_source
from lerobot_act_chunking.recording.robotics import RoboticsSource
from lerobot_act_chunking.recording.simulated import Step

UNTRAINED = (
    f"--policy.type={TYPES[0]} {MODULES[TYPES[0]].TRAINED} --policy.device=cpu --policy.push_to_hub=false"
)
SMALL_VIDEO = (
    "--env.render_quality=fast --env.visualization_height=48 --env.visualization_width=64 "
    "--eval.n_episodes=2 --eval.batch_size=2 --eval.use_async_envs=false"
)


@pytest.fixture
def command(monkeypatch):
    """Run one of LeRobot's commands in this process."""

    def run(main, *arguments: str) -> None:
        monkeypatch.setattr(sys, "argv", ["lerobot", *(word for text in arguments for word in text.split())])
        main()

    return run


@pytest.mark.slow
@pytest.mark.parametrize("task", some(1, ["FrankaKitchen-v1", "AdroitHandDoor-v1"]))
def test_lerobot_eval_with_a_policy_that_has_learned_nothing(task, command, tmp_path):
    environment = f"--env.type=gymnasium_robotics --env.task={task} --env.episode_length=6"
    command(lerobot_eval.main, UNTRAINED, environment, SMALL_VIDEO, f"--output_dir={tmp_path}")
    overall = json.loads((tmp_path / "eval_info.json").read_text())["overall"]
    assert (overall["n_episodes"], overall["pc_success"]) == (2, 0)
    assert len(overall["video_paths"]) == 2


@dataclass(frozen=True)
class Waving(RoboticsSource):
    """Somebody's own demonstrations of a task that has no expert: eight steps at random."""

    def __post_init__(self) -> None:
        """Any task."""

    def steps(self, env, seed):
        observation, _ = env.reset(seed=seed)
        rng = np.random.default_rng(seed)
        for _ in range(8):
            action = rng.uniform(-1, 1, env.action_space.shape).astype(np.float32)
            seen = observation
            observation, *_, info = env.step(action)
            yield Step(seen, action, {**info, "is_success": True})


def record_push(root) -> None:
    asked = "record --env gymnasium_robotics --task FetchPush-v4 --episodes 2 --repo-id test/robotics --root"
    assert main([*asked.split(), str(root)]) == 0


def record_door(root) -> None:
    source = Waving(RoboticsOptions(task="AdroitHandDoor-v1"), ExpertOptions())
    assert record_source(source, Target(root, "test/robotics", 2)).episodes == 2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("task", "record"), some(1, [("FetchPush-v4", record_push), ("AdroitHandDoor-v1", record_door)])
)
def test_recorded_trained_and_evaluated(task, record, command, tmp_path):
    record(tmp_path / "dataset")
    data = f"--dataset.repo_id=test/robotics --dataset.root={tmp_path / 'dataset'} --batch_size=3"
    steps = "--steps=4 --env_eval_freq=2 --save_freq=4 --log_freq=2 --num_workers=0"
    environment = f"--env.type=gymnasium_robotics --env.task={task} --env.episode_length=5"
    out = tmp_path / "run"
    command(lerobot_train.main, UNTRAINED, environment, SMALL_VIDEO, data, steps, f"--output_dir={out}")
    videos = {path.parent.parent.name for path in (out / "eval").rglob("*.mp4")}
    assert videos == {"videos_step_000002", "videos_step_000004"}
    policy = f"--policy.path={out / 'checkpoints' / 'last' / 'pretrained_model'} --policy.device=cpu"
    command(lerobot_eval.main, policy, environment, SMALL_VIDEO, f"--output_dir={tmp_path / 'eval'}")
    assert json.loads((tmp_path / "eval" / "eval_info.json").read_text())["overall"]["n_episodes"] == 2


@pytest.mark.slow
def test_a_policy_that_saw_no_velocities_is_told_when_it_is_shown_them(command, tmp_path):
    sees = {"observation.state": PolicyFeature(FeatureType.STATE, (5,))}
    sees["observation.environment_state"] = PolicyFeature(FeatureType.ENV, (12,))
    actions = {"action": PolicyFeature(FeatureType.ACTION, (4,))}
    config = any_config(input_features=sees, output_features=actions)
    get_policy_class(config.type)(config).save_pretrained(tmp_path / "policy")
    for processor in make_pre_post_processors(config):
        processor.save_pretrained(tmp_path / "policy")
    environment = "--env.type=gymnasium_robotics --env.task=FetchPush-v4 --env.episode_length=2"
    policy = f"--policy.path={tmp_path / 'policy'} --policy.device=cpu --output_dir={tmp_path / 'eval'}"
    command(lerobot_eval.main, policy, environment, "--env.velocities=false", SMALL_VIDEO)
    with pytest.raises(FeatureError, match=r"observation.state.*10"):
        command(lerobot_eval.main, policy, environment, SMALL_VIDEO)


class ThereAndAway(torch.nn.Module):
    """Goes straight to the target, and leaves it after so many steps: a policy to count successes with."""

    def __init__(self, leave_after: int) -> None:
        super().__init__()
        self.leave_after = leave_after

    def reset(self) -> None:
        self.steps = 0

    def select_action(self, observation):
        self.steps += 1
        error = observation["observation.environment_state"] - observation["observation.state"][:, :3]
        direction = (error / 0.05).clamp(-1, 1)
        if self.steps > self.leave_after:
            direction = torch.tensor([-1.0, -1.0, 1.0]).expand_as(direction)
        return torch.nn.functional.pad(direction, (0, 1))


def counted(success: str, leave_after: int, seeds) -> list[bool]:
    """Which episodes LeRobot counts as successes, as `eval_policy` reads a rollout."""
    vector = make_env(RoboticsEnvConfig(success=success), n_envs=len(seeds))["gymnasium_robotics"][0]
    same = [lambda value: value] * 4
    result = lerobot_eval.rollout(vector, ThereAndAway(leave_after), *same, seeds=[*seeds])
    vector.close()
    ends = torch.argmax(result["done"].int(), dim=1, keepdim=True)
    # LeRobot's mask keeps one step of the next episode too; where none is left it makes no difference.
    counts = torch.arange(result["done"].shape[1]) <= ends + 1
    return (result["success"] & counts).any(dim=1).tolist()


@pytest.mark.parametrize(
    ("success", "leave_after", "expected"),
    [("any", 50, True), ("final", 50, True), ("any", 20, True), ("final", 20, False)],
)
def test_lerobot_counts_what_success_says(success, leave_after, expected):
    assert counted(success, leave_after, seeds=range(3)) == [expected] * 3
