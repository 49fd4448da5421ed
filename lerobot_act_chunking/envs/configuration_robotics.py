"""LeRobot's view of gymnasium-robotics' worlds: ``--env.type=gymnasium_robotics``."""

from dataclasses import dataclass, fields
from typing import Any

from lerobot.envs.configs import EnvConfig

from lerobot_act_chunking.envs.configuration_simulation import SimulationEnvConfig
from lerobot_act_chunking.envs.registration import robotics_id
from lerobot_act_chunking.envs.robotics.options import RoboticsOptions
from lerobot_act_chunking.envs.robotics.tasks import get_task
from lerobot_act_chunking.errors import ConfigurationError


@EnvConfig.register_subclass("gymnasium_robotics")
@dataclass
class RoboticsEnvConfig(RoboticsOptions, SimulationEnvConfig):  # pyright: ignore[reportIncompatibleVariableOverride]
    """Any task of ``envs/robotics/tasks.py`` for ``lerobot-eval`` and ``--env_eval_freq``.

    The options are ``RoboticsOptions``'s.

    Raises:
        ConfigurationError: an option that cannot work, found before any simulation starts.
    """

    fps: int = 0
    """Control steps a second; 0, the default, means the task's, and there is no other choice."""

    def __post_init__(self) -> None:
        super().__post_init__()
        task = get_task(self.task)
        if self.fps not in (0, task.fps):
            raise ConfigurationError(
                f"{self.task} runs at {task.fps} control steps a second, got fps={self.fps}"
            )
        self.fps = task.fps
        self.episode_length = self.episode_length or task.episode_length
        states = {"agent_pos": len(self.layout.state_names)}
        self.declare_features(len(task.actions), states, len(self.layout.environment_names))

    @property
    def action_names(self) -> tuple[str, ...]:
        """A name for each number of an action."""
        return get_task(self.task).actions

    @property
    def gym_id(self) -> str:
        """Gymnasium id of the task."""
        return robotics_id(self.task)

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Arguments for ``gymnasium.make``."""
        return {option.name: getattr(self, option.name) for option in fields(RoboticsOptions)}
