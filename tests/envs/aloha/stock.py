"""gym-aloha itself, made quick enough to step beside ours: its images are drawn only when a test asks."""

import os
import warnings
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np

os.environ.setdefault("MUJOCO_GL", "egl")
with warnings.catch_warnings():
    # dm_control and its dependencies use deprecated Python features at import.
    warnings.simplefilter("ignore", DeprecationWarning)
    from gym_aloha.env import BOX_POSE, AlohaEnv

STOCK_TASKS = ("transfer_cube", "insertion")


def make_stock(task: str) -> AlohaEnv:
    """gym-aloha's environment with blank images."""
    env = AlohaEnv(task, obs_type="pixels_agent_pos")
    env._env.physics.render = lambda **_: np.zeros(1, np.uint8)
    return env


def place(env: AlohaEnv, object_pose: np.ndarray) -> None:
    """Start an episode with the objects at a pose of our choice."""
    BOX_POSE[0] = object_pose
    env._env.reset()


def stock_images(task: str, seed: int, actions: np.ndarray) -> dict[str, np.ndarray]:
    """What gym-aloha observes at the start of an episode and after its actions, (2, 480, 640, 3) per camera.

    Drawn in a process of its own: dm_control takes its OpenGL context to be current for ever, so beside
    another renderer it would draw, unnoticed, into that one's framebuffer.
    """
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
        return process.submit(_draw, task, seed, actions).result()


def _draw(task: str, seed: int, actions: np.ndarray) -> dict[str, np.ndarray]:
    env = AlohaEnv(task, obs_type="pixels_agent_pos")
    draw = env._env.physics.render
    env._env.physics.render = lambda **_: np.zeros(1, np.uint8)
    cameras = ("top", "angle", "front_close")

    def look() -> list[np.ndarray]:
        return [draw(height=480, width=640, camera_id=camera) for camera in cameras]

    env.reset(seed=seed)
    frames = [look()]
    for action in actions:
        env.step(action)
    frames.append(look())
    return dict(zip(cameras, np.swapaxes(frames, 0, 1), strict=True))


def smooth_actions(start: np.ndarray, steps: int, rng: np.random.Generator) -> np.ndarray:
    """Random smooth joint targets (steps, 14) that sweep both grippers through the objects on the table."""
    reach = np.array([0.0, 0.84, -0.29, 0.0, 0.45, 0.0, 0.0] * 2)
    spread = np.array([0.2, 0.12, 0.1, 0.2, 0.2, 0.4, 0.5] * 2)
    actions, current = [], start.copy()
    for step in range(steps):
        if step % 20 == 0:
            goal = start + reach + spread * rng.normal(size=14)
        current = current + 0.12 * (goal - current)
        actions.append(current)
    return np.stack(actions)
