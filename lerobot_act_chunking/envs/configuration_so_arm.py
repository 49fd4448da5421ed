"""LeRobot's view of the simulated SO-101: ``--env.type=so_arm_sim``."""

from dataclasses import dataclass, fields
from typing import Any, ClassVar

from lerobot.envs.configs import EnvConfig

from lerobot_act_chunking.envs.configuration_simulation import SimulationEnvConfig
from lerobot_act_chunking.envs.registration import SO_ARM_IDS
from lerobot_act_chunking.envs.so_arm.options import SoArmOptions
from lerobot_act_chunking.envs.so_arm.tasks import JOINTS, NAMES, TASKS, get_task
from lerobot_act_chunking.errors import ConfigurationError

_FPS = 30


@EnvConfig.register_subclass("so_arm_sim")
@dataclass
class SoArmSimEnvConfig(SoArmOptions, SimulationEnvConfig):  # pyright: ignore[reportIncompatibleVariableOverride]
    """A simulated SO-101 for ``lerobot-eval`` and ``--env_eval_freq``; the options are ``SoArmOptions``'s.

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
            raise ConfigurationError(f"so_arm_sim runs at {_FPS} control steps a second, got fps={self.fps}")
        if self.episode_length < 1:
            raise ConfigurationError(f"episode_length is at least one step, got {self.episode_length}")
        environment = len(get_task(self.task).environment_names)
        self.declare_features(len(JOINTS), {"agent_pos": len(JOINTS)}, environment)

    @property
    def action_names(self) -> tuple[str, ...]:
        """A name for each number of an action."""
        return NAMES

    @property
    def gym_id(self) -> str:
        """Gymnasium id of the task."""
        return SO_ARM_IDS[self.task]

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Arguments for ``gymnasium.make``."""
        options = {option.name: getattr(self, option.name) for option in fields(SoArmOptions)}
        return {**options, "max_episode_steps": self.episode_length}
