"""Your own MuJoCo environment in one file: a puck is to reach a dot. See docs/guides/own-environment.md."""

from dataclasses import dataclass

import gymnasium as gym
import mujoco
import numpy as np
from gymnasium.spaces import Box, Dict
from lerobot.envs.configs import EnvConfig

from lerobot_act_chunking.envs.configuration_simulation import SimulationEnvConfig
from lerobot_act_chunking.envs.rendering import OffscreenRenderer

__path__ = []  # LeRobot's --env.discover_packages_path takes every module for a package
gym.register("own/ReachDot-v0", "own_environment:ReachDot", max_episode_steps=60)
MODEL = """<mujoco> <worldbody> <camera name="top" pos="0 0 3"/> <site name="dot" size=".08"/> <body>
<joint name="x" type="slide" axis="1 0 0"/> <joint name="y" type="slide" axis="0 1 0"/> <geom size=".05"/>
</body></worldbody> <actuator><velocity joint="x" kv="5"/><velocity joint="y" kv="5"/></actuator> </mujoco>"""


class ReachDot(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 25}  # noqa: RUF012
    task = task_description = "Move the puck to the dot."
    action_space = Box(-1, 1, (2,))  # velocity [m/s]
    observation_space = Dict(agent_pos=Box(-9, 9, (4,), float), environment_state=Box(-1, 1, (2,), float))

    def __init__(self):
        self.model = mujoco.MjModel.from_xml_string(MODEL)
        self.data, self.renderer, self.dot = mujoco.MjData(self.model), None, self.model.site("dot").pos[:2]

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        self.dot[:] = self.np_random.uniform(-0.8, 0.8, 2)
        mujoco.mj_forward(self.model, self.data)
        return self._observe(), {"is_success": False}

    def step(self, action):
        self.data.ctrl = np.clip(action, -1, 1)
        mujoco.mj_step(self.model, self.data, nstep=20)  # of 2 ms
        distance = float(np.linalg.norm(self.dot - self.data.qpos))
        return self._observe(), -distance, distance < 0.08, False, {"is_success": distance < 0.08}

    def render(self):
        self.renderer = self.renderer or OffscreenRenderer(self.model, 96, 128, effects=False)
        return self.renderer.render(self.data, "top", 96, 128)

    def _observe(self):
        return {"agent_pos": np.r_[self.data.qpos, self.data.qvel], "environment_state": self.dot.copy()}


@EnvConfig.register_subclass("reach_dot")
@dataclass
class ReachDotConfig(SimulationEnvConfig):
    package_name, gym_id, gym_kwargs = "own_environment", "own/ReachDot-v0", {}
    fps: int = 25

    def __post_init__(self):
        self.check_observations(cameras=())  # state only
        self.declare_features(actions=2, states={"agent_pos": 4}, environment=2)
