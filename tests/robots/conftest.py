"""A robot whose time a test turns by hand, and one in real time with small cameras."""

import logging

import pytest

from lerobot_act_chunking.robots.config_so_arm_sim import CameraOptions, FaultOptions, SoArmSimConfig
from lerobot_act_chunking.robots.so_arm_sim import SoArmSim


class Clock:
    """Stands for ``time.perf_counter``."""

    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def make_robot(tmp_path):
    """Robots that are disconnected after the test; with a clock, they have no cameras."""
    made = []

    def build(*, clock=None, faults=None, cameras=None, **options):
        small = CameraOptions(width=32, height=24, fps=50)
        named = {} if clock else dict.fromkeys(cameras or ("front",), small)
        config = SoArmSimConfig(
            calibration_dir=tmp_path, cameras=named, faults=FaultOptions(**(faults or {})), **options
        )
        robot = SoArmSim(config)
        if clock:
            robot.table.clock = clock
        made.append(robot)
        return robot

    yield build
    for robot in made:
        if robot.is_connected:
            robot.disconnect()


@pytest.fixture
def announce():
    """Say what LeRobot's ``log_say`` says."""
    root = logging.getLogger()
    before = root.level
    root.setLevel(logging.INFO)
    yield logging.info
    root.setLevel(before)
