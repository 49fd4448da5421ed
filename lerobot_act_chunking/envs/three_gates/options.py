"""What a user may choose about the three gates, checked for Gymnasium and LeRobot alike."""

from dataclasses import dataclass, field

from lerobot_act_chunking.envs.options import ObservationOptions, check_choice
from lerobot_act_chunking.errors import ConfigurationError

TASK, SUCCESS, CAMERA = "three_gates", "outside", "top"


@dataclass
class ThreeGatesOptions(ObservationOptions):
    """Observations of the three gates.

    Raises:
        ConfigurationError: an unknown name or an impossible size, with what would be accepted.
    """

    task: str = TASK
    """There is one."""
    cameras: list[str] = field(default_factory=lambda: [CAMERA])
    """The camera looks down from above; unused when ``obs_type`` is ``state``."""
    success: str = SUCCESS
    """There is one rule: the mass is behind a gate, wholly outside the ring, which ends the episode."""
    agent_vel: bool = False
    """Also observe the mass's velocity."""

    def __post_init__(self) -> None:
        check_choice("task", self.task, (TASK,))
        check_choice("success rule", self.success, (SUCCESS,))
        self.check_observations((CAMERA,))
        if self.agent_vel and self.obs_type == "pixels":
            raise ConfigurationError("agent_vel needs obs_type state or pixels_state; pixels is images only")
