"""What stands still while a robot acts is told, once, and nothing else is."""

import logging

import numpy as np
import pytest

from lerobot_act_chunking.policies.rollout_watch import RolloutWatch
from lerobot_act_chunking.policies.trained_on import TrainedOn

NAMES = ["elbow.pos", "gripper.pos"]
KNOWN = TrainedOn(
    30.0, {"action": NAMES, "observation.state": NAMES}, {"action": [0.0, 0.0]}, {"action": [100.0, 100.0]}
)


@pytest.fixture
def warned(caplog):
    """What is told while a robot acts for four seconds."""

    def act(every=1, until=np.inf, stuck=(), known=KNOWN):
        steps = iter(range(10_000))
        rng, pictures = np.random.default_rng(0), []
        watch = RolloutWatch(known, 30.0, clock=lambda: next(steps) / 30)
        with caplog.at_level(logging.WARNING):
            for step in range(120):
                if step % every == 0 and step <= until:
                    pictures.append(rng.integers(0, 255, (24, 32, 3), dtype=np.uint8))
                target = np.full(2, 50 + 40 * np.sin(step / 10))
                place = np.where([name in stuck for name in NAMES], 0.0, target)
                watch.see({"observation.state": place, "observation.images.front": pictures[-1]}, target)
        return [each.getMessage() for each in caplog.records]

    return act


def test_a_robot_that_is_well_is_not_mentioned(warned):
    assert warned() == []


def test_a_frozen_camera_is_told_once(warned):
    (line,) = warned(every=1000)
    assert "observation.images.front shows the same picture for 1 s" in line


def test_lost_frames_are_told_once(warned):
    (line,) = warned(every=2)
    assert "a new picture in only 50% of the control steps" in line


def test_a_slow_camera_that_freezes_is_told_twice(warned):
    few, frozen = warned(every=2, until=89)
    assert "a new picture in only" in few
    assert "shows the same picture for 1 s" in frozen


def test_a_blocked_joint_is_told_and_a_gripper_that_holds_something_is_not(warned):
    (line,) = warned(stuck=NAMES)
    assert line.startswith("elbow.pos stays at 0 for 1 s, told to go to")


def test_where_actions_are_no_positions_joints_are_left_alone(warned):
    assert warned(stuck=NAMES, known=TrainedOn(30.0, {"action": NAMES})) == []
