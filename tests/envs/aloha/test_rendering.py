import sys

import mujoco
import numpy as np
import pytest
from headless import run_headless
from stock import STOCK_TASKS, smooth_actions, stock_images
from tiers import some

from lerobot_act_chunking.envs import rendering
from lerobot_act_chunking.envs.aloha.env import AlohaSimEnv
from lerobot_act_chunking.envs.aloha.options import CAMERAS
from lerobot_act_chunking.envs.aloha.world import AlohaWorld, sample_object_pose
from lerobot_act_chunking.errors import ActChunkingError

STOCK_CAMERAS = ("top", "angle", "front_close")


@pytest.fixture
def count_renders(monkeypatch):
    """A list that grows by one at every image MuJoCo draws."""
    drawn, draw = [], mujoco.mjr_render
    monkeypatch.setattr(mujoco, "mjr_render", lambda *args: (drawn.append(args), draw(*args)))
    return drawn


@pytest.fixture
def world():
    world = AlohaWorld("transfer_cube")
    world.reset(sample_object_pose("transfer_cube", np.random.default_rng(0)))
    return world


def image(world, camera, height, width, effects):
    renderer = rendering.OffscreenRenderer(world.model, max_height=height, max_width=width, effects=effects)
    try:
        return renderer.render(world.data, camera, height, width)
    finally:
        renderer.close()


@pytest.mark.parametrize("task", some(1, STOCK_TASKS))
def test_full_quality_is_gym_alohas_to_the_pixel(task):
    env = AlohaSimEnv(task=task, obs_type="pixels", cameras=[*STOCK_CAMERAS])
    frames = [env.reset(seed=3)[0]["pixels"]]
    actions = smooth_actions(env.world.qpos(), 12, np.random.default_rng(3))
    frames.extend(env.step(action)[0]["pixels"] for action in actions)
    env.close()
    for camera, (first, last) in stock_images(task, 3, actions).items():
        assert np.array_equal(frames[0][camera], first), camera
        assert np.array_equal(frames[-1][camera], last), camera
        assert not np.array_equal(first, last), "the arms moved"


@pytest.mark.parametrize(("effects", "samples", "shadows"), [(True, 4, 4096), (False, 0, 0)])
def test_fast_leaves_out_multisampling_and_the_shadow_map(world, effects, samples, shadows):
    renderer = rendering.OffscreenRenderer(world.model, max_height=48, max_width=64, effects=effects)
    context, flags = renderer._context, renderer._scene.flags
    assert (context.offSamples, context.shadowSize) == (samples, shadows)
    assert flags[mujoco.mjtRndFlag.mjRND_REFLECTION] == effects
    renderer.close()


@pytest.mark.parametrize("camera", CAMERAS)
def test_fast_shows_the_same_scene_without_shadows(camera):
    images = {}
    for quality in ("full", "fast"):
        env = AlohaSimEnv(obs_type="pixels", cameras=[camera], render_quality=quality)
        images[quality] = env.reset(seed=0)[0]["pixels"][camera].astype(float)
        env.close()
    difference = np.abs(images["full"] - images["fast"])
    assert 0 < difference.mean() < 8
    assert images["fast"].mean() > images["full"].mean(), "shadows darken"


def test_an_image_is_upright_and_shows_the_cube(world):
    frame = image(world, "top", 480, 640, effects=True).astype(int)
    rows, columns = np.nonzero((frame[..., 0] > 150) & (frame[..., 1] < 100))
    # Right of the middle, as x > 0; in the lower half, as y is nearer than the table's middle at 0.6.
    assert 0 < world.environment_state()[0] < 0.2
    assert world.environment_state()[1] < 0.57
    assert columns.mean() > 320
    assert rows.mean() > 240


@pytest.mark.parametrize(
    ("options", "per_observation"),
    [
        ({"obs_type": "state"}, 0),
        ({"obs_type": "pixels", "cameras": ["angle"]}, 1),
        ({"obs_type": "pixels_state", "cameras": ["top", "left_wrist", "right_wrist"]}, 3),
    ],
)
def test_renders_only_what_was_asked_for(count_renders, options, per_observation):
    env = AlohaSimEnv(observation_height=24, observation_width=32, **options)
    env.reset(seed=0)
    env.step(env.world.qpos())
    assert len(count_renders) == 2 * per_observation
    env.close()


@pytest.mark.parametrize("scale", [1, 4, 20, 30])
def test_any_size_shows_the_whole_view(world, scale):
    frame = image(world, "angle", 24 * scale, 32 * scale, effects=False)
    assert (frame.shape, frame.dtype) == ((24 * scale, 32 * scale, 3), np.uint8)
    reduced = frame.reshape(24, scale, 32, scale, 3).mean(axis=(1, 3))
    assert np.abs(reduced - image(world, "angle", 24, 32, effects=False)).mean() < 9


def test_sizes_share_a_context_and_do_not_disturb_each_other(world):
    renderer = rendering.OffscreenRenderer(world.model, max_height=480, max_width=640, effects=True)
    small = renderer.render(world.data, "top", 60, 80)
    large = renderer.render(world.data, "top", 480, 640)
    assert np.array_equal(small, renderer.render(world.data, "top", 60, 80))
    assert np.array_equal(large, image(world, "top", 480, 640, effects=True))
    renderer.close()


def test_close_frees_the_context_and_can_be_repeated():
    env = AlohaSimEnv(obs_type="pixels", observation_height=24, observation_width=32)
    env.reset(seed=0)
    renderer = env._images._renderer
    env.close()
    env.close()
    assert not renderer.close.alive
    assert env.reset(seed=0)[0]["pixels"]["top"].shape == (24, 32, 3), "an image afterwards opens a new one"
    env.close()


def test_missing_opengl_names_the_fix(monkeypatch, world):
    def absent():
        raise ImportError("libEGL.so.1: cannot open shared object file")

    monkeypatch.setattr(rendering, "_platform", absent)
    with pytest.raises(
        ActChunkingError, match=r"libEGL.*apt install libegl1 libopengl0 libgl1-mesa-dri.*MUJOCO_GL=egl"
    ):
        image(world, "top", 48, 64, effects=False)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux renders without a display through EGL")
def test_headless_linux_renders_through_egl_and_exits_silently():
    program = """
import sys, weakref
from lerobot_act_chunking.envs.aloha.env import AlohaSimEnv
weakref.finalize(AlohaSimEnv, int)  # as torch and others do: finalizers then run after EGL shuts down
env = AlohaSimEnv(obs_type="pixels", observation_height=24, observation_width=32)
assert "mujoco.egl" not in sys.modules, "chosen at the first image"
env.reset(seed=0)
print(type(env._images._renderer._gl).__module__)
"""
    done = run_headless(program)
    assert (done.returncode, done.stdout.strip(), done.stderr) == (0, "mujoco.egl", "")


@pytest.mark.skipif(sys.platform != "linux", reason="EGL devices are a Linux matter")
@pytest.mark.parametrize("choice", [{"MUJOCO_GL": "egl", "MUJOCO_EGL_DEVICE_ID": "99"}, {"MUJOCO_GL": "off"}])
def test_an_unusable_platform_is_explained(choice):
    program = """
from lerobot_act_chunking.envs.aloha.env import AlohaSimEnv
AlohaSimEnv(obs_type="pixels").reset(seed=0)
"""
    done = run_headless(program, **choice)
    assert done.returncode == 1
    assert "ActChunkingError: cannot render: OpenGL is not available" in done.stderr
