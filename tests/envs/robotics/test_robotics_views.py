"""Images of gymnasium-robotics' worlds."""

import os

import mujoco
import numpy as np
import pytest
from tiers import some

from lerobot_act_chunking.envs.robotics.env import RoboticsEnv
from lerobot_act_chunking.envs.robotics.tasks import TASKS, get_task

os.environ.setdefault("MUJOCO_GL", "egl")  # Gymnasium's renderer would open a window system first


@pytest.fixture
def images():
    """The first images of a task, by camera."""
    made = []

    def look(task, seed=0, **options):
        made.append(RoboticsEnv(task=task, obs_type="pixels", **options))
        return made[-1].reset(seed=seed)[0]["pixels"]

    yield look
    for env in made:
        env.close()


def as_the_original_renders(task, seed, lookat=None):
    """The original's own render(), 480 x 480, through Gymnasium."""
    import gymnasium as gym

    env = gym.make(task, render_mode="rgb_array", disable_env_checker=True, width=480, height=480)
    env.reset(seed=seed)
    env.render()
    if lookat is not None:
        env.unwrapped.mujoco_renderer.viewer.cam.lookat[:] = lookat
    image = env.render()
    env.close()
    return image


@pytest.mark.parametrize("task", some(1, ["FetchPush-v4", "HandReach-v3", "FrankaKitchen-v1"]))
def test_full_quality_is_the_originals_to_the_pixel(task, images):
    ours = images(task, seed=3, observation_height=480, observation_width=480)["view"]
    assert np.array_equal(ours, as_the_original_renders(task, seed=3))


def test_adroit_looks_the_same_way_in_every_episode(images):
    size = {"observation_height": 480, "observation_width": 480}
    ours = images("AdroitHandRelocate-v1", seed=3, **size)["view"]
    env = RoboticsEnv(task="AdroitHandRelocate-v1")
    lookat = env._views._view.lookat
    assert np.array_equal(ours, as_the_original_renders("AdroitHandRelocate-v1", seed=3, lookat=lookat))
    env.close()


@pytest.mark.parametrize("task", TASKS)
def test_every_camera_shows_something_at_any_size(task, images):
    cameras = [*get_task(task).cameras]
    seen = images(task, cameras=cameras, observation_height=30, observation_width=50, render_quality="fast")
    assert [*seen] == cameras
    for camera, image in seen.items():
        assert (image.shape, image.dtype) == ((30, 50, 3), np.uint8), camera
    assert seen["view"].std() > 5


def test_fast_leaves_out_shadows_alone(images):
    size = {"observation_height": 60, "observation_width": 80}
    full, fast = (
        images("FetchPush-v4", render_quality=quality, **size)["view"] for quality in ("full", "fast")
    )
    difference = np.abs(full.astype(float) - fast)
    assert 0 < difference.mean() < 12


def test_fetchs_goal_is_marked_where_it_is():
    env = RoboticsEnv(task="FetchReach-v4", visualization_height=24, visualization_width=32)
    env.reset(seed=1)
    env.render()
    marked = env._views._data
    assert np.allclose(marked.site("target0").xpos, env.original.goal)
    assert env.original.data is not marked
    env.close()


def test_a_large_image_needs_no_setting(images):
    assert images("FetchReach-v4", observation_height=700, observation_width=900)["view"].shape == (
        700,
        900,
        3,
    )


def test_close_frees_the_context():
    env = RoboticsEnv(task="FetchReach-v4", visualization_height=24, visualization_width=32)
    env.reset(seed=0)
    env.render()
    renderer = env._views._images._renderer
    env.close()
    env.close()
    assert not renderer.close.alive
    assert isinstance(env.original.model, mujoco.MjModel)


def test_no_images_without_a_render_mode():
    env = RoboticsEnv(task="FetchReach-v4", render_mode=None)
    env.reset(seed=0)
    assert env.render() is None
    env.close()
