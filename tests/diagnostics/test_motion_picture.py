from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from lerobot_act_chunking.diagnostics.motion import Motion, environment_for, plot_motion
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.loading import load_policy


class Features:
    """The part of a policy configuration that decides which environment it needs."""

    def __init__(self, images: dict[str, tuple[int, ...]], others: tuple[str, ...] = ()):
        self.image_features = {key: Shape(shape) for key, shape in images.items()}
        self.input_features = {**self.image_features, **dict.fromkeys(others)}


class Shape:
    def __init__(self, shape):
        self.shape = shape


def test_the_environment_gives_what_the_policy_was_trained_on():
    state = environment_for(Features({}, ("observation.state",)), task="insertion", success="hold")
    assert (state.task, state.success, state.obs_type, state.agent_vel) == (
        "insertion",
        "hold",
        "state",
        False,
    )

    moving = environment_for(Features({}, ("observation.agent_vel",)), task="transfer_cube", success="touch")
    assert moving.agent_vel

    images = {"observation.images.top": (3, 60, 80), "observation.images.angle": (3, 60, 80)}
    seeing = environment_for(Features(images, ("observation.state",)), task="transfer_cube", success="touch")
    assert (seeing.obs_type, list(seeing.cameras)) == ("pixels_state", ["top", "angle"])
    assert (seeing.observation_height, seeing.observation_width) == (60, 80)
    assert environment_for(Features(images), task="transfer_cube", success="touch").obs_type == "pixels"


def test_cameras_of_two_sizes_are_refused():
    images = {"observation.images.top": (3, 60, 80), "observation.images.angle": (3, 30, 40)}
    with pytest.raises(
        ConfigurationError, match=r"one image size, the policy wants \[\(30, 40\), \(60, 80\)\]"
    ):
        environment_for(Features(images), task="transfer_cube", success="touch")


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
            replan_interval=5,
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
