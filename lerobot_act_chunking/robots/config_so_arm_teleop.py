"""``--teleop.type=so_arm_sim``: a scripted person who leads the simulated SO-101."""

from dataclasses import dataclass

from lerobot.teleoperators.config import TeleoperatorConfig

from lerobot_act_chunking.envs.operators import get_operator
from lerobot_act_chunking.errors import ConfigurationError


@TeleoperatorConfig.register_subclass("so_arm_sim")
@dataclass
class SoArmTeleopConfig(TeleoperatorConfig):
    """A scripted person at a leader arm, who sees the table of a ``so_arm_sim`` robot in the same process.

    Raises:
        ConfigurationError: no such person.
    """

    operator: str = "steady"
    """Who demonstrates: ``steady``, ``hesitant``, ...; several, with commas between them, take turns."""
    robot_id: str | None = None
    """The ``--robot.id`` of the robot that is led, where it has one."""

    def __post_init__(self) -> None:
        if not self.operators:
            raise ConfigurationError("operator is empty: name one, as in steady or brisk,shaky")
        for name in self.operators:
            get_operator(name)

    @property
    def operators(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(name.strip() for name in self.operator.split(",") if name.strip())
