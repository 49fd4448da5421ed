"""LeRobot's view of this package's environments: ``--env.type=aloha_sim``."""

from dataclasses import dataclass, fields
from multiprocessing import get_context
from typing import Any

import gymnasium as gym
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_IMAGES, OBS_STATE, OBS_STR

from lerobot_act_chunking.envs.aloha.options import AlohaSimOptions
from lerobot_act_chunking.envs.aloha.tasks import JOINT_NAMES, get_task
from lerobot_act_chunking.envs.registration import GYM_IDS
from lerobot_act_chunking.errors import ConfigurationError

_FPS = 50
_WORKER_MODULES = ("lerobot.scripts.lerobot_eval", __name__, "lerobot_act_chunking.envs.aloha.env")


@EnvConfig.register_subclass("aloha_sim")
@dataclass
class AlohaSimEnvConfig(AlohaSimOptions, EnvConfig):  # pyright: ignore[reportIncompatibleVariableOverride]
    """ALOHA simulation for ``lerobot-eval`` and ``--env_eval_freq``; the options are ``AlohaSimOptions``'s.

    ``features`` and ``features_map`` follow from the options: ``agent_pos`` is ``observation.state``,
    ``agent_vel`` ``observation.agent_vel``, ``environment_state`` ``observation.environment_state``, a camera
    ``observation.images.<camera>``.

    Raises:
        ConfigurationError: an option that cannot work, found before any simulation starts.
    """

    fps: int = _FPS
    episode_length: int = 400
    """Control steps after which an episode is cut."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.fps != _FPS:
            raise ConfigurationError(f"aloha_sim runs at {_FPS} control steps a second, got fps={self.fps}")
        if self.episode_length < 1:
            raise ConfigurationError(f"episode_length is at least one step, got {self.episode_length}")
        self.features = self._features()
        self.features_map = {key: _POLICY_KEYS.get(key, key) for key in self.features}

    @property
    def package_name(self) -> str:
        """The package whose import registers ``gym_id``."""
        return "lerobot_act_chunking"

    @property
    def gym_id(self) -> str:
        """Gymnasium id of the task."""
        return GYM_IDS[self.task]

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Arguments for ``gymnasium.make``."""
        options = {option.name: getattr(self, option.name) for option in fields(AlohaSimOptions)}
        return {**options, "max_episode_steps": self.episode_length}

    def create_envs(
        self, n_envs: int, use_async_envs: bool = False
    ) -> dict[str, dict[int, gym.vector.VectorEnv]]:
        """``n_envs`` environments in one vector environment, as ``{"aloha_sim": {0: vector}}``.

        Asynchronous workers start from Python's fork server, and each imports the running LeRobot command
        anew; imported once in the server they share it, and four workers start in the time of one.
        """
        if use_async_envs and n_envs > 1:
            get_context("forkserver").set_forkserver_preload([*_WORKER_MODULES])
        return super().create_envs(n_envs, use_async_envs)

    def _features(self) -> dict[str, PolicyFeature]:
        joints = (len(JOINT_NAMES),)
        features = {ACTION: PolicyFeature(FeatureType.ACTION, joints)}
        if self.obs_type != "pixels":
            features["agent_pos"] = PolicyFeature(FeatureType.STATE, joints)
        if self.agent_vel:
            features["agent_vel"] = PolicyFeature(FeatureType.STATE, joints)
        if self.obs_type == "state":
            pose = (get_task(self.task).pose_size,)
            features["environment_state"] = PolicyFeature(FeatureType.ENV, pose)
            return features
        image = PolicyFeature(FeatureType.VISUAL, (self.observation_height, self.observation_width, 3))
        # Named as in datasets: lerobot-eval's recording looks images up under this very name.
        return features | {f"{OBS_IMAGES}.{camera}": image for camera in self.cameras}


_POLICY_KEYS = {
    "agent_pos": OBS_STATE,
    "agent_vel": f"{OBS_STR}.agent_vel",  # LeRobot passes further arrays on under their own names
    "environment_state": OBS_ENV_STATE,
}
