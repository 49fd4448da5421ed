"""Shared configuration of the simulated environments."""

from collections.abc import Mapping
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any, ClassVar

import gymnasium as gym
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_IMAGES, OBS_STATE, OBS_STR

from lerobot_act_chunking.envs.options import ObservationOptions
from lerobot_act_chunking.errors import ConfigurationError

_POLICY_KEYS = {
    "agent_pos": OBS_STATE,
    "agent_vel": f"{OBS_STR}.agent_vel",  # LeRobot passes further arrays on under their own names
    "environment_state": OBS_ENV_STATE,
}


@dataclass
class SimulationEnvConfig(ObservationOptions, EnvConfig):
    """An environment whose observations follow from ``ObservationOptions``.

    ``features`` and ``features_map`` follow from the options: ``agent_pos`` is ``observation.state``,
    ``agent_vel`` ``observation.agent_vel``, ``environment_state`` ``observation.environment_state``, a camera
    ``observation.images.<camera>``.
    """

    task_names: ClassVar[tuple[str, ...]] = ()
    """Values of ``task`` that commands know without the environment's type."""

    @classmethod
    def options_for(cls, config: Any, given: Mapping[str, Any]) -> dict[str, Any]:
        """Options that show a policy what it was trained on, also velocities; images are rendered fast.

        Args:
            config: the policy's.
            given: options that win.

        Raises:
            ConfigurationError: the policy sees images of several sizes, and none is given.
        """
        images = config.image_features
        moving = _POLICY_KEYS["agent_vel"] in config.input_features
        usual = {"render_quality": "fast", **({"agent_vel": moving} if hasattr(cls, "agent_vel") else {})}
        if not images:
            return {"obs_type": "state", **usual, **given}
        return {
            "obs_type": "pixels_state" if config.input_features.keys() - images.keys() else "pixels",
            "cameras": [key.removeprefix(f"{OBS_IMAGES}.") for key in images],
            **usual,
            **_image_size(images, given),
            **given,
        }

    @property
    def package_name(self) -> str:
        """The package whose import registers ``gym_id``."""
        return "lerobot_act_chunking"

    def create_envs(
        self, n_envs: int, use_async_envs: bool = False
    ) -> dict[str, dict[int, gym.vector.VectorEnv]]:
        """``n_envs`` environments in one vector environment, as ``{type: {0: vector}}``.

        Asynchronous workers start from Python's fork server, and each imports the running LeRobot command
        anew; imported once in the server they share it, and four workers start in the time of one.
        """
        if use_async_envs and n_envs > 1:
            entry_point, _, _ = str(gym.spec(self.gym_id).entry_point).partition(":")
            modules = ["lerobot.scripts.lerobot_eval", type(self).__module__, entry_point]
            get_context("forkserver").set_forkserver_preload(modules)
        return super().create_envs(n_envs, use_async_envs)

    def declare_features(self, actions: int, states: Mapping[str, int], environment: int) -> None:
        """Set ``features`` and ``features_map`` to what ``obs_type`` observes.

        Args:
            actions: numbers in an action.
            states: names and sizes of the robot's vectors.
            environment: size of ``environment_state``.
        """
        self.features = {ACTION: PolicyFeature(FeatureType.ACTION, (actions,))}
        if self.obs_type != "pixels":
            self.features |= {
                name: PolicyFeature(FeatureType.STATE, (size,)) for name, size in states.items()
            }
        if self.obs_type == "state":
            self.features["environment_state"] = PolicyFeature(FeatureType.ENV, (environment,))
        else:
            image = PolicyFeature(FeatureType.VISUAL, (self.observation_height, self.observation_width, 3))
            # Named as in datasets: lerobot-eval's recording looks images up under this very name.
            self.features |= {f"{OBS_IMAGES}.{camera}": image for camera in self.cameras}
        self.features_map = {key: _POLICY_KEYS.get(key, key) for key in self.features}


def _image_size(images: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, int]:
    names = ("observation_height", "observation_width")
    sizes = {tuple(feature.shape[-2:]) for feature in images.values()}
    if len(sizes) > 1 and not given.keys() >= set(names):
        raise ConfigurationError(
            f"an environment renders one image size, the policy wants {sorted(sizes)}: choose one by "
            "--env.observation_height and --env.observation_width"
        )
    return dict(zip(names, sizes.pop(), strict=True))
