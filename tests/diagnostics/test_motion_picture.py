from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from lerobot_act_chunking.diagnostics.motion import Motion, plot_motion
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.loading import load_policy


def test_the_picture_shows_commands_of_both_arms(tmp_path):
    def picture(commands: np.ndarray) -> np.ndarray:
        steps = len(commands)
        motion = Motion(
            title="a test",
            dt=0.02,
            joint_names=[f"left_arm_{i}" for i in range(7)] + [f"right_arm_{i}" for i in range(7)],
            commands=commands,
            positions=np.zeros_like(commands),
            rewards=np.zeros(steps),
            success=False,
            replans=range(0, steps, 5),
            frames=[(step, np.full((6, 8, 3), 10 * step, np.uint8)) for step in range(0, steps, 2)],
        )
        return matplotlib.image.imread(plot_motion(motion, tmp_path / "deep" / "motion.png"))

    still = picture(np.zeros((20, 14)))
    for arm in (slice(0, 6), slice(7, 13)):
        commands = np.zeros((20, 14))
        commands[:, arm] = np.linspace(0, 1, 20)[:, None]
        moved = picture(commands)
        assert moved.shape == still.shape
        assert (moved != still).mean() > 0.001


def test_the_picture_shows_actions_of_robots_without_positions(tmp_path):
    def picture(commands: np.ndarray) -> np.ndarray:
        names = ["x", "y", "z", "gripper"]
        none = np.zeros((9, 0))
        motion = Motion("a test", 0.04, names, commands, none, np.zeros(9), success=False)
        return matplotlib.image.imread(plot_motion(motion, tmp_path / "motion.png"))

    still = picture(np.zeros((9, 4)))
    for column in (1, 3):
        commands = np.zeros((9, 4))
        commands[:, column] = np.linspace(0, 1, 9)
        assert (picture(commands) != still).mean() > 0.001


@pytest.mark.parametrize("path", ["./nowhere", "a/b/c", "outputs"])
def test_a_missing_checkpoint_is_named_before_the_hub_is_asked(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigurationError, match=f"there is no checkpoint at {path}"):
        load_policy(path)


def test_a_folder_without_a_config_is_told_from_a_checkpoint(tmp_path):
    with pytest.raises(
        ConfigurationError, match=r"holds no config\.json; give a checkpoint's pretrained_model"
    ):
        load_policy(Path(tmp_path))
