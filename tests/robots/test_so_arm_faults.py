"""Cameras that deliver late, and everything that goes wrong on request."""

import time

import numpy as np
import pytest
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from lerobot_act_chunking.envs.so_arm.tasks import NAMES
from lerobot_act_chunking.envs.so_arm.world import HOME
from lerobot_act_chunking.errors import ActChunkingError
from lerobot_act_chunking.robots import camera as camera_module

AWAY = dict(zip(NAMES, (60.0, -20.0, 40.0, 50.0, 20.0, 60.0), strict=True))
PATIENCE = 20.0  # [s]: the machine may be busy


def until(condition):
    """Wait for what happens in another thread."""
    deadline = time.perf_counter() + PATIENCE
    while time.perf_counter() < deadline:
        if condition():
            return True
        time.sleep(0.005)
    return False


def picture(robot, name="front"):
    return robot.get_observation()[name]


def test_pictures_are_new_ones_while_the_arm_moves(make_robot):
    robot = make_robot(cameras=("front", "wrist"))
    robot.connect()
    first = {name: picture(robot, name) for name in ("front", "wrist")}
    assert first["front"].shape == (24, 32, 3)
    assert first["front"].dtype == np.uint8
    robot.send_action(AWAY)
    for name in ("front", "wrist"):
        assert until(lambda: not np.array_equal(picture(robot, name), first[name]))  # noqa: B023


def test_cameras_are_read_as_lerobots_are(make_robot):
    robot = make_robot()
    camera = robot.cameras["front"]
    with pytest.raises(DeviceNotConnectedError, match="camera front is not connected"):
        camera.read_latest()
    robot.connect()
    with pytest.raises(DeviceAlreadyConnectedError):
        camera.connect()
    assert camera.read().shape == camera.async_read(timeout_ms=1000 * PATIENCE).shape == (24, 32, 3)
    assert (camera.width, camera.height, camera.fps) == (32, 24, 50)
    assert camera.find_cameras() == []
    robot.disconnect()
    assert not camera.is_connected
    with pytest.raises(DeviceNotConnectedError):
        camera.disconnect()


def test_a_late_camera_shows_the_past(make_robot):
    robot = make_robot(camera_latency_s=0.4)
    robot.connect()
    first, sent = picture(robot), time.perf_counter()
    robot.send_action(AWAY)
    assert until(lambda: not np.array_equal(picture(robot), first))
    assert time.perf_counter() - sent > 0.4


def test_lost_pictures_leave_the_one_before(make_robot):
    def distinct(share):
        robot = make_robot(faults={"dropped_frames": share})
        robot.connect()
        camera, taken = robot.cameras["front"], set()
        begin = time.perf_counter()
        while time.perf_counter() - begin < 0.6:
            taken.add(id(camera.read_latest(max_age_ms=60_000)))
            time.sleep(0.002)
        robot.disconnect()
        return len(taken)

    assert distinct(0.95) < distinct(0.0)


def test_a_frozen_camera_repeats_itself_and_the_other_does_not(make_robot):
    robot = make_robot(cameras=("front", "wrist"), faults={"frozen_camera": "wrist", "after_s": 0.1})
    robot.connect()
    assert until(lambda: robot.cameras["wrist"].read() is robot.cameras["wrist"].read())
    wrist, front = picture(robot, "wrist"), picture(robot)
    robot.send_action(AWAY)
    assert until(lambda: not np.array_equal(picture(robot), front))
    assert picture(robot, "wrist") is wrist


def test_an_unplugged_camera_times_out(make_robot):
    robot = make_robot(faults={"unplugged_camera": "front", "after_s": 0.1})
    robot.connect()
    assert picture(robot).shape == (24, 32, 3)
    with pytest.raises(TimeoutError, match="latest picture of the camera front is too old"):
        until(lambda: picture(robot) is None)
    robot.cameras["front"].async_read()
    with pytest.raises(TimeoutError, match="timed out waiting 20 ms"):
        robot.cameras["front"].async_read(timeout_ms=20)


def test_late_observations_are_those_of_then(make_robot, clock):
    robot = make_robot(clock=clock, faults={"late_observation_s": 0.2})
    robot.connect()
    robot.send_action(AWAY)
    true, seen = [], []
    for _ in range(30):
        seen.append(robot.get_observation()["shoulder_pan.pos"])
        true.append(robot.table.joints()[0])
        clock.now += 1 / 30
    np.testing.assert_allclose(seen[7:], true[1:-6], atol=1e-6)
    assert seen[:6] == [pytest.approx(HOME[0], abs=1e-9)] * 6


def test_jitter_delays_observations_by_up_to_its_limit(make_robot, clock, monkeypatch):
    robot = make_robot(clock=clock, faults={"loop_jitter_s": 0.05})
    robot.connect()
    slept = []
    monkeypatch.setattr("lerobot_act_chunking.robots.so_arm_sim.time.sleep", slept.append)
    for _ in range(200):
        robot.get_observation()
    assert 0 <= min(slept) < 0.005
    assert 0.045 < max(slept) <= 0.05


@pytest.mark.parametrize("joint", ["elbow_flex", "gripper"])
def test_a_blocked_joint_stays_and_the_others_move(make_robot, clock, joint):
    robot = make_robot(clock=clock, faults={"blocked_joint": joint, "after_s": 1.0})
    robot.connect()
    clock.now += 2
    before = robot.get_observation()
    for _ in range(60):
        robot.send_action(AWAY)
        clock.now += 1 / 30
    after = robot.get_observation()
    moved = {name: abs(after[name] - before[name]) for name in NAMES}
    assert moved.pop(f"{joint}.pos") < 0.1
    assert min(moved.values()) > 10


def test_a_joint_is_blocked_only_from_then_on(make_robot, clock):
    robot = make_robot(clock=clock, faults={"blocked_joint": "shoulder_pan", "after_s": 5.0})
    robot.connect()
    for _ in range(60):
        robot.send_action(AWAY)
        clock.now += 1 / 30
    assert robot.get_observation()["shoulder_pan.pos"] == pytest.approx(60, abs=1)


def test_without_opengl_connecting_says_so(make_robot, monkeypatch):
    def refuse(*_, **__):
        raise ActChunkingError("cannot render: OpenGL is not available")

    monkeypatch.setattr(camera_module, "OffscreenRenderer", refuse)
    robot = make_robot()
    with pytest.raises(ActChunkingError, match="OpenGL is not available"):
        robot.connect()
    assert not robot.cameras["front"].is_connected
