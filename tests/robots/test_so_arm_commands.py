"""LeRobot's own commands, unmodified, with the simulated SO-101 and its operator."""

import os
import subprocess
import sys

import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset
from lerobot.robots.utils import make_robot_from_config
from lerobot.teleoperators.utils import make_teleoperator_from_config
from policy_cases import MODULES, TYPES
from tiers import full_tier

from lerobot_act_chunking.envs.so_arm.tasks import NAMES
from lerobot_act_chunking.envs.so_arm.world import HOME
from lerobot_act_chunking.robots.config_so_arm_sim import SoArmSimConfig
from lerobot_act_chunking.robots.config_so_arm_teleop import SoArmTeleopConfig
from lerobot_act_chunking.robots.so_arm_sim import SoArmSim
from lerobot_act_chunking.robots.so_arm_teleop import SoArmTeleop

CAMERAS = "{front: {width: 64, height: 48}, wrist: {width: 64, height: 48}}"
ROBOT = ["--robot.type=so_arm_sim", f"--robot.cameras={CAMERAS}", "--robot.seed=3"]
TELEOP = ["--teleop.type=so_arm_sim", "--teleop.operator=brisk"]


def test_lerobot_makes_both_from_their_configurations(tmp_path):
    assert type(make_robot_from_config(SoArmSimConfig(calibration_dir=tmp_path))) is SoArmSim
    teleop = make_teleoperator_from_config(SoArmTeleopConfig(calibration_dir=tmp_path))
    assert type(teleop) is SoArmTeleop
    assert list(teleop.action_features) == list(NAMES)


@pytest.fixture
def lerobot(tmp_path):
    """Run a command of LeRobot in a process of its own; what it logged."""

    def run(name, *arguments):
        done = subprocess.run(
            [sys.executable, "-m", f"lerobot.scripts.lerobot_{name}", *arguments],
            env={**os.environ, "HF_LEROBOT_HOME": str(tmp_path / "home"), "HF_HUB_OFFLINE": "1"},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr[-4000:]
        return done.stderr

    return run


def dataset(name, root, *, seconds):
    return [
        f"--dataset.repo_id=test/{name}",
        f"--dataset.root={root}",
        "--dataset.num_episodes=2",
        f"--dataset.episode_time_s={seconds}",
        "--dataset.reset_time_s=2",
        "--dataset.single_task=Put the cube into the box.",
        "--dataset.push_to_hub=false",
        "--dataset.rgb_encoder.vcodec=h264",
        "--play_sounds=false",
    ]


@pytest.fixture
def recorded(lerobot, tmp_path):
    """Two episodes of the operator, and what was said of them."""
    return lerobot("record", *ROBOT, *TELEOP, *dataset("arm", tmp_path / "arm", seconds=7))


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_recorded_episodes_begin_at_home_and_end_in_success(recorded, tmp_path):
    """The machine may be busy: what counts is that most episodes succeed, not each."""
    assert "2 of 2 episodes succeeded" in recorded or "1 of 2 episodes succeeded" in recorded
    data = LeRobotDataset("test/arm", root=tmp_path / "arm")
    assert data.num_episodes == 2
    assert data.features["action"]["names"] == list(NAMES)
    assert data.features["observation.images.wrist"]["shape"] == (48, 64, 3)
    for start in data.meta.episodes["dataset_from_index"]:
        np.testing.assert_allclose(data[start]["observation.state"], HOME, atol=5)


@full_tier
@pytest.mark.timeout(900)
@pytest.mark.usefixtures("recorded")
def test_replayed_trained_and_rolled_out(lerobot, tmp_path):
    data = ["--dataset.repo_id=test/arm", f"--dataset.root={tmp_path / 'arm'}"]
    first = [*data, "--dataset.episode=0", "--play_sounds=false"]
    assert "the episode of seed 3" in lerobot("replay", *ROBOT, *first)
    assert "of 1 episodes" in lerobot("teleoperate", *ROBOT, *TELEOP, "--fps=30", "--teleop_time_s=1")

    run, policy = tmp_path / "run", f"--policy.type={TYPES[0]} {MODULES[TYPES[0]].TRAINED}"
    asked = f"{policy} --policy.device=cpu --policy.push_to_hub=false --steps=1 --batch_size=2"
    lerobot("train", *asked.split(), "--num_workers=0", *data, f"--output_dir={run}")
    checkpoint = f"--policy.path={run / 'checkpoints' / 'last' / 'pretrained_model'}"
    rolled = [*ROBOT, checkpoint, "--policy.device=cpu", "--device=cpu"]
    assert "of 1 episodes" in lerobot("rollout", *rolled, "--duration=1", "--play_sounds=false")
    episodic = ["--strategy.type=episodic", *dataset("rollout_arm", tmp_path / "rollout", seconds=1)]
    said = lerobot("rollout", *rolled, *episodic)
    assert "the episode of seed 4 failed" in said
    assert "of 2 episodes succeeded" in said
