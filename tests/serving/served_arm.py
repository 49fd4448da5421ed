"""An arm for LeRobot's robot client, with a camera, that notes what it is told."""

from dataclasses import dataclass, field

import numpy as np
from lerobot.robots.config import RobotConfig

JOINTS = tuple(f"joint_{number}.pos" for number in range(6))


@RobotConfig.register_subclass("served_arm")
@dataclass
class ServedArmConfig(RobotConfig):
    joints: list = field(default_factory=lambda: list(JOINTS))
    camera: str = "top"


class ServedArm:
    """Stands still, so that every chunk is for the same observation."""

    name = robot_type = "served_arm"

    def __init__(self, config):
        self.config, self.actions = config, []
        self.is_connected = False

    @property
    def observation_features(self):
        return dict.fromkeys(self.config.joints, float) | {self.config.camera: (32, 48, 3)}

    @property
    def action_features(self):
        return dict.fromkeys(self.config.joints[:4], float)

    def connect(self):
        self.is_connected = True

    def disconnect(self):
        self.is_connected = False

    def get_observation(self):
        image = np.random.default_rng(0).integers(0, 255, (32, 48, 3), dtype=np.uint8)
        return {name: 0.1 * number for number, name in enumerate(self.config.joints)} | {
            self.config.camera: image
        }

    def send_action(self, action):
        self.actions.append(list(action.values()))
        return action
