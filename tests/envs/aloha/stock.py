"""gym-aloha itself, made quick enough to step beside ours: its images are drawn only when a test asks."""

import os
import warnings

import numpy as np

os.environ.setdefault("MUJOCO_GL", "egl")
with warnings.catch_warnings():
    # dm_control and its dependencies use deprecated Python features at import.
    warnings.simplefilter("ignore", DeprecationWarning)
    from gym_aloha.env import AlohaEnv


def make_stock(task: str) -> AlohaEnv:
    """gym-aloha's environment with blank images; ``stock_image`` still draws."""
    env = AlohaEnv(task, obs_type="pixels_agent_pos")
    env._env.physics.render = lambda **_: np.zeros(1, np.uint8)
    return env


def stock_image(env: AlohaEnv, camera: str) -> np.ndarray:
    """What gym-aloha observes through ``camera`` at 480 x 640."""
    physics = env._env.physics
    return type(physics).render(physics, height=480, width=640, camera_id=camera)


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
