"""What a user may choose about any simulated environment's observations, checked in one place."""

from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from lerobot_act_chunking.errors import ConfigurationError, unknown_choice

ObservationType = Literal["state", "pixels", "pixels_state"]
RenderQuality = Literal["full", "fast"]

MAX_IMAGE_SIDE = 4096
"""Largest image side [pixels]; software OpenGL offers no larger framebuffer everywhere."""


@dataclass
class ObservationOptions:
    """Vectors or images, which cameras, how large; environments add their own fields and check them.

    Names are plain ``str``: LeRobot's command line has one ``--env.obs_type`` for all environment types, and
    the ``Literal`` of the type that registered last would refuse the values of every other.
    """

    obs_type: str = "state"
    """``state``: vectors of the robot and of its surroundings. ``pixels``: images only. ``pixels_state``:
    images and the robot's vector; the surroundings stay out of it, as no camera-driven robot knows them."""
    cameras: list[str] = field(default_factory=list)
    """Cameras to render at each step; unused when ``obs_type`` is ``state``."""
    observation_height: int = 480
    observation_width: int = 640
    render_quality: str = "full"
    """``full``: the original's. ``fast``: no shadows, reflections, multisampling; for lack of a GPU."""
    visualization_height: int = 480
    visualization_width: int = 640

    def check_observations(self, cameras: tuple[str, ...]) -> None:
        """Refuse what cannot be observed where there are these ``cameras``.

        Raises:
            ConfigurationError: an unknown name or an impossible size, with what would be accepted.
        """
        check_choice("obs_type", self.obs_type, get_args(ObservationType))
        check_choice("render_quality", self.render_quality, get_args(RenderQuality))
        for use in ("observation", "visualization"):
            _check_image_side(f"{use}_height", getattr(self, f"{use}_height"))
            _check_image_side(f"{use}_width", getattr(self, f"{use}_width"))
        self._check_cameras(cameras)

    def _check_cameras(self, choices: tuple[str, ...]) -> None:
        if isinstance(self.cameras, str):
            raise ConfigurationError(f"cameras is a list of names: write [{self.cameras!r}]")
        for camera in self.cameras:
            check_choice("camera", camera, choices)
        if len(set(self.cameras)) != len(self.cameras):
            raise ConfigurationError(f"cameras {list(self.cameras)} names one twice; name each once")
        if not self.cameras and self.obs_type != "state":
            raise ConfigurationError(f"obs_type {self.obs_type} needs cameras, of: {', '.join(choices)}")


def check_choice(what: str, value: object, choices: tuple[str, ...]) -> None:
    """Raise ConfigurationError, with the choices, if ``value`` is none of them."""
    if value not in choices:
        raise unknown_choice(what, value, choices)


def _check_image_side(name: str, value: Any) -> None:
    if type(value) is not int or not 1 <= value <= MAX_IMAGE_SIDE:
        raise ConfigurationError(f"{name} is a whole number of pixels, 1 to {MAX_IMAGE_SIDE}, got {value!r}")
