"""What to record, checked before anything expensive starts."""

import re
from dataclasses import dataclass, field
from pathlib import Path

from lerobot_act_chunking.envs.aloha.options import (
    AlohaSimOptions,
    ObservationType,
    RenderQuality,
    SuccessRuleName,
    TaskName,
)
from lerobot_act_chunking.envs.experts import ExpertOptions
from lerobot_act_chunking.errors import ConfigurationError

_REPO_ID = re.compile(r"[A-Za-z0-9][\w.-]*/[A-Za-z0-9][\w.-]*", re.ASCII)


@dataclass(frozen=True)
class RecordSpec:
    """A recording of ALOHA demonstrations.

    Attributes:
        repo_id: the dataset's name, user/name.
        root: the dataset's folder; by default where LeRobot looks for ``repo_id``.
        task: transfer_cube or insertion.
        episodes: successful episodes to record.
        obs: ``state`` records joints and object poses, ``pixels`` cameras, ``pixels_state`` both cameras and
            joints.
        velocity: also record joint velocities.
        cameras: cameras to record, by default the one on top; none with ``obs="state"``.
        image_height: of every camera [px], even.
        image_width: of every camera [px], even.
        render_quality: ``full`` looks like gym-aloha, ``fast`` leaves out what is slow without a GPU.
        success: the rule an episode must meet to be recorded, ``hold`` or ``touch``.
        seed: of the first episode; the next ones count up.
        expert: how the expert moves.
        workers: processes that play episodes; the dataset does not depend on it.

    Raises:
        ConfigurationError: a value that cannot work.
    """

    repo_id: str
    root: Path | None = None
    task: TaskName = "transfer_cube"
    episodes: int = 50
    obs: ObservationType = "state"
    velocity: bool = False
    cameras: tuple[str, ...] = ()
    image_height: int = 480
    image_width: int = 640
    render_quality: RenderQuality = "full"
    success: SuccessRuleName = "hold"
    seed: int = 0
    expert: ExpertOptions = field(default_factory=ExpertOptions)
    workers: int = 1

    def __post_init__(self) -> None:
        if not _REPO_ID.fullmatch(self.repo_id):
            raise ConfigurationError(
                f"repo id {self.repo_id!r} is not of the form user/name (letters, digits, '-', '_', '.')"
            )
        for name, least in (("episodes", 1), ("workers", 1), ("seed", 0)):
            if getattr(self, name) < least:
                raise ConfigurationError(f"{name} is {getattr(self, name)}; it must be {least} or more")
        if self.obs == "state" and self.cameras:
            names = ", ".join(self.cameras)
            raise ConfigurationError(f"obs state records no cameras, got {names}; use pixels or pixels_state")
        self.environment()
        for name in ("image_height", "image_width"):
            if getattr(self, name) % 2:
                raise ConfigurationError(f"{name} is {getattr(self, name)}; H.264 videos need even sizes")

    def environment(self) -> AlohaSimOptions:
        """The environment that shows what is recorded.

        Raises:
            ConfigurationError: an unknown task, camera, rule or quality, or an impossible image size.
        """
        return AlohaSimOptions(
            task=self.task,
            obs_type=self.obs,
            cameras=list(self.cameras or ("top",)),
            observation_height=self.image_height,
            observation_width=self.image_width,
            render_quality=self.render_quality,
            success=self.success,
            agent_vel=self.velocity,
        )
