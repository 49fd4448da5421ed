"""What to record, checked before anything expensive starts."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from act_chunking_runtime.number_checks import check_at_least
from lerobot_act_chunking.envs.aloha.options import AlohaSimOptions
from lerobot_act_chunking.envs.demonstration import ExpertOptions
from lerobot_act_chunking.envs.robotics.options import RoboticsOptions
from lerobot_act_chunking.envs.so_arm.options import SoArmOptions
from lerobot_act_chunking.envs.three_gates.options import ThreeGatesOptions
from lerobot_act_chunking.errors import ConfigurationError, unknown_choice
from lerobot_act_chunking.executors import Cluster
from lerobot_act_chunking.recording.aloha import AlohaSource
from lerobot_act_chunking.recording.robotics import RoboticsSource
from lerobot_act_chunking.recording.simulated import SimulatedSource
from lerobot_act_chunking.recording.so_arm import SoArmSource
from lerobot_act_chunking.recording.three_gates import ThreeGatesSource

_REPO_ID = re.compile(r"[A-Za-z0-9][\w.-]*/[A-Za-z0-9][\w.-]*", re.ASCII)


@dataclass(frozen=True)
class _Kind:
    """Demonstrations of one type of environment, and what is recorded unless something else is asked for."""

    source: type[SimulatedSource]
    options: type[Any]
    success: str
    velocity: str | None
    """The option by which velocities are observed; None where there is none."""


_KINDS: Mapping[str, _Kind] = {
    "aloha_sim": _Kind(AlohaSource, AlohaSimOptions, success="hold", velocity="agent_vel"),
    "gymnasium_robotics": _Kind(RoboticsSource, RoboticsOptions, success="final", velocity="velocities"),
    "so_arm_sim": _Kind(SoArmSource, SoArmOptions, success="released", velocity=None),
    "three_gates": _Kind(ThreeGatesSource, ThreeGatesOptions, success="outside", velocity="agent_vel"),
}


@dataclass(frozen=True)
class RecordSpec:
    """A recording of demonstrations.

    Attributes:
        repo_id: the dataset's name, user/name.
        root: the dataset's folder; by default where LeRobot looks for ``repo_id``.
        env: LeRobot's environment type, ``aloha_sim``, ``gymnasium_robotics``, ``so_arm_sim`` or
            ``three_gates``.
        task: of the environment; by default ``transfer_cube``, ``FetchReach-v4``, ``pick_place`` or
            ``three_gates``.
        episodes: successful episodes to record.
        obs: ``state`` records vectors of the robot and its surroundings, ``pixels`` cameras, ``pixels_state``
            both cameras and the robot.
        velocity: whether to record velocities; by default ALOHA's are not, and gymnasium-robotics' are, being
            part of the original observation; the SO-101 has none.
        cameras: cameras to record, by default ``top``, ``view`` or ``front,wrist``; none with
            ``obs="state"``.
        image_height: of every camera [px], even.
        image_width: of every camera [px], even.
        render_quality: ``full`` looks like the original, ``fast`` leaves out what is slow without a GPU.
        success: the rule an episode must meet to be recorded: ALOHA's ``hold`` (default) or ``touch``;
            gymnasium-robotics' ``final`` (default, the whole episode) or ``any`` (up to the first success);
            the SO-101's ``released`` (default) or ``placed``.
        seed: of the first episode; the next ones count up.
        expert: how the expert moves.
        operators: people whose habits it takes on, in turn from seed to seed; none by default. They are in
            ``lerobot_act_chunking.envs.operators``.
        mode_shares: percentages of the episodes that go each way, where a task has several; by default equal
            ones.
        workers: processes that play episodes; the dataset does not depend on it.
        cluster: whose processes; by default this machine's.

    Raises:
        ConfigurationError: a value that cannot work.
    """

    repo_id: str
    root: Path | None = None
    env: str = "aloha_sim"
    task: str | None = None
    episodes: int = 50
    obs: str = "state"
    velocity: bool | None = None
    cameras: tuple[str, ...] = ()
    image_height: int = 480
    image_width: int = 640
    render_quality: str = "full"
    success: str | None = None
    seed: int = 0
    expert: ExpertOptions = field(default_factory=ExpertOptions)
    operators: tuple[str, ...] = ()
    mode_shares: tuple[float, ...] = ()
    workers: int = 1
    cluster: Cluster | None = None

    def __post_init__(self) -> None:
        if not _REPO_ID.fullmatch(self.repo_id):
            raise ConfigurationError(
                f"repo id {self.repo_id!r} is not of the form user/name (letters, digits, '-', '_', '.')"
            )
        if self.env not in _KINDS:
            raise unknown_choice("env", self.env, _KINDS)
        check_at_least(1, episodes=self.episodes, workers=self.workers)
        check_at_least(0, seed=self.seed)
        if self.obs == "state" and self.cameras:
            names = ", ".join(self.cameras)
            raise ConfigurationError(f"obs state records no cameras, got {names}; use pixels or pixels_state")
        self.source()
        for name in ("image_height", "image_width"):
            if getattr(self, name) % 2:
                raise ConfigurationError(f"{name} is {getattr(self, name)}; H.264 videos need even sizes")

    def source(self) -> SimulatedSource:
        """The episodes that are recorded.

        Raises:
            ConfigurationError: an unknown task, camera, rule or quality, an impossible image size, shares
                that are not the task's, or what its expert cannot do.
        """
        kind = _KINDS[self.env]
        environment = kind.options(**self._environment(kind))
        return kind.source(environment, self.expert, self.operators, self.mode_shares)

    def _environment(self, kind: _Kind) -> dict[str, Any]:
        options: dict[str, Any] = {
            "obs_type": self.obs,
            "observation_height": self.image_height,
            "observation_width": self.image_width,
            "render_quality": self.render_quality,
            "success": self.success or kind.success,
        }
        if self.task is not None:
            options["task"] = self.task
        if self.cameras:
            options["cameras"] = list(self.cameras)
        if self.velocity is not None:
            if kind.velocity is None:
                raise ConfigurationError(f"{self.env} observes no velocities; leave velocity out")
            options[kind.velocity] = self.velocity
        return options
