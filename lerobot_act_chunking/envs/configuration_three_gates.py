"""LeRobot's view of the three gates: ``--env.type=three_gates``."""

from dataclasses import dataclass, fields
from typing import Any, ClassVar

from lerobot.envs.configs import EnvConfig

from lerobot_act_chunking.envs.configuration_simulation import SimulationEnvConfig
from lerobot_act_chunking.envs.registration import THREE_GATES_ID
from lerobot_act_chunking.envs.three_gates.options import TASK, ThreeGatesOptions
from lerobot_act_chunking.envs.three_gates.world import ACTION_NAMES, FPS
from lerobot_act_chunking.errors import ConfigurationError


@EnvConfig.register_subclass("three_gates")
@dataclass
class ThreeGatesEnvConfig(ThreeGatesOptions, SimulationEnvConfig):  # pyright: ignore[reportIncompatibleVariableOverride]
    """The three gates for ``lerobot-eval`` and ``--env_eval_freq``; the options are ``ThreeGatesOptions``'s.

    Raises:
        ConfigurationError: an option that cannot work, found before any simulation starts.
    """

    task_names: ClassVar[tuple[str, ...]] = (TASK,)
    fps: int = FPS
    episode_length: int = 40
    """Control steps after which an episode is cut."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.fps != FPS:
            raise ConfigurationError(f"three_gates runs at {FPS} control steps a second, got fps={self.fps}")
        if self.episode_length < 1:
            raise ConfigurationError(f"episode_length is at least one step, got {self.episode_length}")
        vectors = ("agent_pos", "agent_vel") if self.agent_vel else ("agent_pos",)
        self.declare_features(2, dict.fromkeys(vectors, 2), 6)

    @property
    def action_names(self) -> tuple[str, ...]:
        """A name for each number of an action."""
        return ACTION_NAMES

    @property
    def gym_id(self) -> str:
        """Gymnasium id."""
        return THREE_GATES_ID

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Arguments for ``gymnasium.make``."""
        options = {option.name: getattr(self, option.name) for option in fields(ThreeGatesOptions)}
        return {**options, "max_episode_steps": self.episode_length}
