"""LeRobot's view of gymnasium-robotics' worlds: ``--env.type=gymnasium_robotics``."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar

from lerobot.envs.configs import EnvConfig
from lerobot.utils.constants import OBS_ENV_STATE, OBS_STATE

from lerobot_act_chunking.envs.configuration_simulation import SimulationEnvConfig
from lerobot_act_chunking.envs.registration import robotics_id
from lerobot_act_chunking.envs.robotics.options import RoboticsOptions
from lerobot_act_chunking.envs.robotics.tasks import TASKS, get_task
from lerobot_act_chunking.errors import ConfigurationError


@EnvConfig.register_subclass("gymnasium_robotics")
@dataclass
class RoboticsEnvConfig(RoboticsOptions, SimulationEnvConfig):  # pyright: ignore[reportIncompatibleVariableOverride]
    """Any task of ``envs/robotics/tasks.py`` for ``lerobot-eval`` and ``--env_eval_freq``.

    The options are ``RoboticsOptions``'s.

    Raises:
        ConfigurationError: an option that cannot work, found before any simulation starts.
    """

    task_names: ClassVar[tuple[str, ...]] = tuple(TASKS)
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

    @classmethod
    def options_for(cls, config: Any, given: Mapping[str, Any]) -> dict[str, Any]:
        """As of `SimulationEnvConfig`, with velocities where the policy saw them."""
        complete = get_task(given.get("task", cls.task))
        sizes = {OBS_STATE: len(complete.state_names), OBS_ENV_STATE: len(complete.environment_names)}
        seen = config.input_features
        velocities = all(seen[key].shape == (size,) for key, size in sizes.items() if key in seen)
        return super().options_for(config, {"velocities": velocities, **given})

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
