"""What a user may choose about the ALOHA environment, checked in one place for Gymnasium and for LeRobot."""

from dataclasses import dataclass, field
from typing import Literal, get_args

from lerobot_act_chunking.envs.aloha.instructions import INSTRUCTIONS
from lerobot_act_chunking.envs.aloha.tasks import TASKS, get_task
from lerobot_act_chunking.envs.options import (
    MAX_IMAGE_SIDE,
    ObservationOptions,
    ObservationType,
    RenderQuality,
    check_choice,
)
from lerobot_act_chunking.errors import ConfigurationError

__all__ = [
    "CAMERAS",
    "MAX_IMAGE_SIDE",
    "AlohaSimOptions",
    "ObservationType",
    "RenderQuality",
    "SuccessRuleName",
    "TaskName",
]

TaskName = Literal["transfer_cube", "insertion", "transfer_modes", "language_transfer"]
SuccessRuleName = Literal["touch", "hold"]

CAMERAS = ("top", "angle", "front_close", "left_pillar", "right_pillar", "left_wrist", "right_wrist")
"""The cameras of gym-aloha's models."""


@dataclass
class AlohaSimOptions(ObservationOptions):
    """Task, observations and success rule of an ALOHA environment.

    Raises:
        ConfigurationError: an unknown name or an impossible size, with what would be accepted.
    """

    task: str = "transfer_cube"
    """One of ``TASKS``."""
    cameras: list[str] = field(default_factory=lambda: ["top"])
    """Cameras to render at each step, any of ``CAMERAS``; unused when ``obs_type`` is ``state``."""
    success: str = "touch"
    """Which rule is ``is_success`` and ends the episode: gym-aloha's ``touch``, or ``hold`` for ten steps."""
    agent_vel: bool = False
    """Also observe joint velocities."""
    instructions: str = "seen"
    """Of language_transfer: words that demonstrations are recorded with (``seen``), others (``unseen``), or
    words for a goal drawn apart from the one that counts (``shuffled``): one in six then fits by chance."""

    def __post_init__(self) -> None:
        check_choice("task", self.task, TASKS)
        check_choice("success rule", self.success, get_args(SuccessRuleName))
        self.check_observations(CAMERAS)
        check_choice("instructions", self.instructions, INSTRUCTIONS)
        if self.instructions != "seen" and not get_task(self.task).cubes:
            raise ConfigurationError(
                f"instructions={self.instructions} is for language_transfer; {self.task} has one instruction"
            )
        if self.agent_vel and self.obs_type == "pixels":
            raise ConfigurationError("agent_vel needs obs_type state or pixels_state; pixels is images only")
