"""What a user may choose about a gymnasium-robotics environment, checked for Gymnasium and LeRobot alike."""

from dataclasses import dataclass, field
from typing import Literal, get_args

from lerobot_act_chunking.envs.options import ObservationOptions, check_choice
from lerobot_act_chunking.envs.robotics.layout import RoboticsTask
from lerobot_act_chunking.envs.robotics.tasks import get_task
from lerobot_act_chunking.errors import ConfigurationError

SuccessRuleName = Literal["any", "final"]


@dataclass
class RoboticsOptions(ObservationOptions):
    """Task, observations and success rule of a gymnasium-robotics environment.

    Raises:
        ConfigurationError: an unknown name or an impossible size, with what would be accepted.
    """

    task: str = "FetchReach-v4"
    """One of ``TASKS``."""
    cameras: list[str] = field(default_factory=lambda: ["view"])
    """Cameras to render at each step, of the task's; unused when ``obs_type`` is ``state``."""
    success: str = "any"
    """``any``: the first step that succeeds ends the episode, as LeRobot counts. ``final``: the episode runs
    to its end and its last step decides, as the literature on the Fetch tasks counts."""
    velocities: bool = True
    """Whether the robot's and the objects' velocities are observed. They give away the action before this
    one, which a policy that imitates then repeats: docs/guides/robotics.md has the figures."""
    episode_length: int = 0
    """Control steps after which an episode is cut; 0, the default, means the original's."""

    def __post_init__(self) -> None:
        task = get_task(self.task)
        check_choice("success rule", self.success, get_args(SuccessRuleName))
        self.check_observations(task.cameras)
        if self.episode_length < 0:
            raise ConfigurationError(
                f"episode_length is a number of steps, or 0 for the original's, got {self.episode_length}"
            )

    @property
    def layout(self) -> RoboticsTask:
        """The task, with what is observed of it."""
        task = get_task(self.task)
        return task if self.velocities else task.without_velocities()
