"""What a user may choose about the ALOHA environment, checked in one place for Gymnasium and for LeRobot."""

from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from lerobot_act_chunking.envs.aloha.tasks import TASKS
from lerobot_act_chunking.errors import ConfigurationError, unknown_choice

TaskName = Literal["transfer_cube", "insertion"]
ObservationType = Literal["state", "pixels", "pixels_state"]
RenderQuality = Literal["full", "fast"]
SuccessRuleName = Literal["touch", "hold"]

CAMERAS = ("top", "angle", "front_close", "left_pillar", "right_pillar", "left_wrist", "right_wrist")
"""The cameras of gym-aloha's models."""

MAX_IMAGE_SIDE = 4096
"""Largest image side [pixels]; software OpenGL offers no larger framebuffer everywhere."""


@dataclass
class AlohaSimOptions:
    """Task, observations and success rule of an ALOHA environment.

    Raises:
        ConfigurationError: an unknown name or an impossible size, with what would be accepted.
    """

    task: TaskName = "transfer_cube"
    obs_type: ObservationType = "state"
    """``state``: joint positions and object poses. ``pixels``: images only. ``pixels_state``: images and
    joint positions; object poses stay out of it, as no camera-driven robot knows them."""
    cameras: list[str] = field(default_factory=lambda: ["top"])
    """Cameras to render at each step, any of ``CAMERAS``; unused when ``obs_type`` is ``state``."""
    observation_height: int = 480
    observation_width: int = 640
    render_quality: RenderQuality = "full"
    """``full``: gym-aloha's pixels. ``fast``: no shadows, reflections, multisampling; for lack of a GPU."""
    success: SuccessRuleName = "touch"
    """Which rule is ``is_success`` and ends the episode: gym-aloha's ``touch``, or ``hold`` for ten steps."""
    agent_vel: bool = False
    """Also observe joint velocities."""
    visualization_height: int = 480
    visualization_width: int = 640

    def __post_init__(self) -> None:
        _check_choice("task", self.task, TASKS)
        _check_choice("obs_type", self.obs_type, get_args(ObservationType))
        _check_choice("render_quality", self.render_quality, get_args(RenderQuality))
        _check_choice("success rule", self.success, get_args(SuccessRuleName))
        for use in ("observation", "visualization"):
            _check_image_side(f"{use}_height", getattr(self, f"{use}_height"))
            _check_image_side(f"{use}_width", getattr(self, f"{use}_width"))
        self._check_cameras()
        if self.agent_vel and self.obs_type == "pixels":
            raise ConfigurationError("agent_vel needs obs_type state or pixels_state; pixels is images only")

    def _check_cameras(self) -> None:
        if isinstance(self.cameras, str):
            raise ConfigurationError(f"cameras is a list of names: write [{self.cameras!r}]")
        for camera in self.cameras:
            _check_choice("camera", camera, CAMERAS)
        if len(set(self.cameras)) != len(self.cameras):
            raise ConfigurationError(f"cameras {list(self.cameras)} names one twice; name each once")
        if not self.cameras and self.obs_type != "state":
            raise ConfigurationError(f"obs_type {self.obs_type} needs cameras, of: {', '.join(CAMERAS)}")


def _check_choice(what: str, value: object, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise unknown_choice(what, value, choices)


def _check_image_side(name: str, value: Any) -> None:
    if type(value) is not int or not 1 <= value <= MAX_IMAGE_SIDE:
        raise ConfigurationError(f"{name} is a whole number of pixels, 1 to {MAX_IMAGE_SIDE}, got {value!r}")
