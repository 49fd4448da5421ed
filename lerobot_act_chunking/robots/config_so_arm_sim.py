"""``--robot.type=so_arm_sim``: a simulated SO-101 that runs in real time."""

from dataclasses import dataclass, field, fields
from math import isfinite

from lerobot.robots.config import RobotConfig

from lerobot_act_chunking.envs.options import MAX_IMAGE_SIDE, check_choice
from lerobot_act_chunking.envs.so_arm.options import CAMERAS, SoArmOptions
from lerobot_act_chunking.envs.so_arm.tasks import ARM_JOINTS
from lerobot_act_chunking.errors import ConfigurationError


@dataclass
class CameraOptions:
    """A simulated camera."""

    width: int = 640
    height: int = 480
    fps: int = 30
    """Frames a second that it delivers."""


@dataclass
class FaultOptions:
    """What goes wrong, to see what a policy and a control loop make of it; nothing by default.

    Raises:
        ConfigurationError: an unknown camera or joint, or an impossible number.
    """

    after_s: float = 0.0
    """From when on [s after the robot is connected] a camera is frozen or unplugged, or a joint blocked."""
    frozen_camera: str | None = None
    """A camera that delivers the same picture for ever."""
    unplugged_camera: str | None = None
    """A camera that delivers nothing any more: reading it raises TimeoutError, as LeRobot's cameras do."""
    blocked_joint: str | None = None
    """A joint that does not move any more, as ``elbow_flex``."""
    dropped_frames: float = 0.0
    """Share of the pictures of every camera that never arrive; the one before it stays the latest."""
    late_observation_s: float = 0.0
    """Age [s] of the joint positions that are observed."""
    loop_jitter_s: float = 0.0
    """Longest time [s] that an observation takes in addition, drawn anew for each."""

    def __post_init__(self) -> None:
        for name, choices in (
            ("frozen_camera", CAMERAS),
            ("unplugged_camera", CAMERAS),
            ("blocked_joint", (*ARM_JOINTS, "gripper")),
        ):
            if getattr(self, name) is not None:
                check_choice(name, getattr(self, name), choices)
        if not 0 <= self.dropped_frames < 1:
            raise ConfigurationError(f"dropped_frames is a share, 0 to below 1, got {self.dropped_frames}")
        for name in ("after_s", "late_observation_s", "loop_jitter_s"):
            _check_seconds(name, getattr(self, name))


@RobotConfig.register_subclass("so_arm_sim")
@dataclass
class SoArmSimConfig(RobotConfig):
    """A simulated SO-101 with the observations and actions of ``so101_follower``.

    Raises:
        ConfigurationError: an unknown task or camera, or an impossible number.
    """

    task: str = "pick_place"
    """``pick_place``, ``stack`` or ``two_ways``: what lies on the table."""
    seed: int = 0
    """Where the objects lie in the first episode; it counts up from episode to episode."""
    cameras: dict[str, CameraOptions] = field(
        default_factory=lambda: {name: CameraOptions() for name in CAMERAS}
    )
    """Cameras by name, ``front`` and ``wrist``; as in {front: {width: 320, height: 240}}."""
    camera_latency_s: float = 0.0
    """How much later [s] than it is taken a picture arrives; rendering it takes time besides."""
    render_quality: str = "fast"
    """``fast``: no shadows, reflections, multisampling. ``full`` needs a GPU to keep 30 frames a second."""
    backlash: float = 0.0
    """Play between each servo of the arm and its joint [degrees]; a real SO-101 has about 1."""
    sensor_noise: float = 0.0
    """Standard deviation of what the motors report about where they are [degrees]."""
    faults: FaultOptions = field(default_factory=FaultOptions)
    """What goes wrong."""

    def __post_init__(self) -> None:
        super().__post_init__()
        names = {option.name for option in fields(SoArmOptions)} & {option.name for option in fields(self)}
        shared = {name: getattr(self, name) for name in names - {"cameras"}}
        SoArmOptions(**shared, cameras=list(self.cameras))
        _check_seconds("camera_latency_s", self.camera_latency_s)
        if self.seed < 0:
            raise ConfigurationError(f"seed is 0 or more, got {self.seed}")
        for name, camera in self.cameras.items():
            sides = (camera.width, camera.height)
            if not (all(0 < side <= MAX_IMAGE_SIDE for side in sides) and camera.fps > 0):
                raise ConfigurationError(
                    f"camera {name} cannot deliver {camera.width} x {camera.height} at {camera.fps} fps: "
                    f"sides are 1 to {MAX_IMAGE_SIDE} pixels, and fps at least 1"
                )


def _check_seconds(name: str, value: float) -> None:
    if not (isfinite(value) and value >= 0):
        raise ConfigurationError(f"{name} is a number of seconds, 0 or more, got {value}")
