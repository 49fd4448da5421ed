"""What a user may choose about the SO-101's simulation, checked for Gymnasium and for LeRobot alike."""

from dataclasses import dataclass, field
from math import isfinite

from lerobot_act_chunking.envs.options import ObservationOptions, check_choice
from lerobot_act_chunking.envs.so_arm.tasks import SUCCESS_RULES, TASKS
from lerobot_act_chunking.errors import ConfigurationError

CAMERAS = ("front", "wrist")
"""In front of the arm, looking at it, and on the gripper, looking at the fingers."""
_MOST_BACKLASH, _MOST_NOISE = 3.0, 5.0  # [degrees]


@dataclass
class SoArmOptions(ObservationOptions):
    """Task, observations, success rule and flaws of a simulated SO-101.

    Raises:
        ConfigurationError: an unknown name or an impossible number, with what would be accepted.
    """

    task: str = "pick_place"
    """One of ``TASKS``."""
    cameras: list[str] = field(default_factory=lambda: list(CAMERAS))
    """Cameras to render at each step, any of ``CAMERAS``; unused when ``obs_type`` is ``state``."""
    success: str = "released"
    """Which rule is ``is_success`` and ends the episode: ``released``, the cube rests in its place and
    nothing holds it, for ten steps; or ``placed``, it is there at any step."""
    backlash: float = 0.0
    """Play between each servo of the arm and its joint [degrees]; a real SO-101 has about 1."""
    sensor_noise: float = 0.0
    """Standard deviation of what the motors report about where they are [degrees]."""

    def __post_init__(self) -> None:
        check_choice("task", self.task, TASKS)
        check_choice("success rule", self.success, SUCCESS_RULES)
        self.check_observations(CAMERAS)
        for name, most in (("backlash", _MOST_BACKLASH), ("sensor_noise", _MOST_NOISE)):
            value = getattr(self, name)
            if not (isfinite(value) and 0 <= value <= most):
                raise ConfigurationError(f"{name} is 0 to {most:g} degrees, got {value}")
