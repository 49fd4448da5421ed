"""LeRobot's view of the ALOHA simulation: ``--env.type=aloha_sim``."""

from dataclasses import dataclass, fields
from typing import Any, ClassVar

from lerobot.envs.configs import EnvConfig

from lerobot_act_chunking.envs.aloha.options import AlohaSimOptions
from lerobot_act_chunking.envs.aloha.tasks import JOINT_NAMES, TASKS, get_task
from lerobot_act_chunking.envs.configuration_simulation import SimulationEnvConfig
from lerobot_act_chunking.envs.registration import GYM_IDS
from lerobot_act_chunking.errors import ConfigurationError

_FPS = 50


@EnvConfig.register_subclass("aloha_sim")
@dataclass
class AlohaSimEnvConfig(AlohaSimOptions, SimulationEnvConfig):  # pyright: ignore[reportIncompatibleVariableOverride]
    """ALOHA simulation for ``lerobot-eval`` and ``--env_eval_freq``; the options are ``AlohaSimOptions``'s.

    Raises:
        ConfigurationError: an option that cannot work, found before any simulation starts.
    """

    task_names: ClassVar[tuple[str, ...]] = TASKS
    fps: int = _FPS
    episode_length: int = 400
    """Control steps after which an episode is cut."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.fps != _FPS:
            raise ConfigurationError(f"aloha_sim runs at {_FPS} control steps a second, got fps={self.fps}")
        if self.episode_length < 1:
            raise ConfigurationError(f"episode_length is at least one step, got {self.episode_length}")
        vectors = ("agent_pos", "agent_vel") if self.agent_vel else ("agent_pos",)
        joints = len(JOINT_NAMES)
        self.declare_features(joints, dict.fromkeys(vectors, joints), get_task(self.task).pose_size)

    @property
    def action_names(self) -> tuple[str, ...]:
        """A name for each number of an action."""
        return JOINT_NAMES

    @property
    def gym_id(self) -> str:
        """Gymnasium id of the task."""
        return GYM_IDS[self.task]

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Arguments for ``gymnasium.make``."""
        options = {option.name: getattr(self, option.name) for option in fields(AlohaSimOptions)}
        return {**options, "max_episode_steps": self.episode_length}
