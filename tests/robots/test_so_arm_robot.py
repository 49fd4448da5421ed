"""The simulated SO-101 as a robot and its scripted operator: time, episodes, and what is sent and seen."""

import numpy as np
import pytest
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from lerobot_act_chunking.envs.so_arm.env import SoArmEnv
from lerobot_act_chunking.envs.so_arm.tasks import NAMES
from lerobot_act_chunking.envs.so_arm.world import HOME
from lerobot_act_chunking.errors import ConfigurationError, FeatureError
from lerobot_act_chunking.recording.spec import RecordSpec
from lerobot_act_chunking.robots.config_so_arm_sim import CameraOptions, FaultOptions, SoArmSimConfig
from lerobot_act_chunking.robots.config_so_arm_teleop import SoArmTeleopConfig
from lerobot_act_chunking.robots.so_arm_teleop import SoArmTeleop

AWAY = dict(zip(NAMES, (40.0, -60.0, 60.0, 50.0, 20.0, 60.0), strict=True))


@pytest.fixture
def make_teleop(tmp_path):
    def build(**options):
        teleop = SoArmTeleop(SoArmTeleopConfig(calibration_dir=tmp_path, **options))
        teleop.connect()
        return teleop

    return build


def loop(robot, teleop, clock, seconds):
    """As ``lerobot-record``'s loop: what was observed and sent at 30 Hz."""
    frames = []
    for _ in range(round(30 * seconds)):
        observation, action = robot.get_observation(), teleop.get_action()
        frames.append((observation, robot.send_action(action)))
        clock.now += 1 / 30
    return frames


def values(frames):
    return np.array([[sent[name] for name in NAMES] for _, sent in frames])


def test_features_are_the_followers(make_robot):
    robot = make_robot(cameras=("front", "wrist"))
    assert list(robot.observation_features) == [*NAMES, "front", "wrist"]
    assert robot.observation_features["wrist"] == (24, 32, 3)
    assert robot.action_features == dict.fromkeys(NAMES, float)
    assert robot.name == "so_arm_sim"
    assert SoArmSimConfig().cameras == dict.fromkeys(("front", "wrist"), CameraOptions(640, 480, 30))


def test_what_is_seen_does_not_depend_on_how_often_somebody_looks(make_robot, clock):
    seen = []
    for looks in (1, 7, 60):
        clock.now = 100.0
        robot = make_robot(clock=clock)
        robot.connect()
        robot.send_action(AWAY)
        for _ in range(looks):
            clock.now += 0.5 / looks
            robot.get_observation()
        clock.now = 100.5
        seen.append([robot.get_observation()[name] for name in NAMES])
        robot.disconnect()
    np.testing.assert_allclose(seen[1], seen[0], atol=1e-9)
    np.testing.assert_allclose(seen[2], seen[0], atol=1e-9)
    assert 10 < seen[0][0] < 41


def test_time_stands_still_before_and_after(make_robot, clock):
    robot = make_robot(clock=clock)
    with pytest.raises(DeviceNotConnectedError):
        robot.get_observation()
    clock.now += 100
    robot.connect()
    with pytest.raises(DeviceAlreadyConnectedError):
        robot.connect()
    observation = robot.get_observation()
    np.testing.assert_allclose([observation[name] for name in NAMES], HOME, atol=1e-9)
    robot.disconnect()
    with pytest.raises(DeviceNotConnectedError):
        robot.send_action(AWAY)
    clock.now += 100
    robot.connect()  # again: from home, with the next objects
    robot.send_action(AWAY)
    clock.now += 1
    assert robot.get_observation()["shoulder_pan.pos"] == pytest.approx(40, abs=2)
    assert robot.table.seed == 1


def test_actions_are_clipped_to_the_limits_and_must_be_complete(make_robot, clock):
    robot = make_robot(clock=clock)
    robot.connect()
    sent = robot.send_action({**AWAY, "shoulder_pan.pos": 500.0, "gripper.pos": -3.0, "other": 1.0})
    assert sent["shoulder_pan.pos"] == pytest.approx(110)
    assert sent["gripper.pos"] == 0.0
    assert sent["wrist_roll.pos"] == 20.0
    with pytest.raises(FeatureError, match=r"lacks gripper\.pos"):
        robot.send_action(dict.fromkeys(NAMES[:5], 0.0))
    with pytest.raises(FeatureError, match="not finite at elbow_flex"):
        robot.send_action({**AWAY, "elbow_flex.pos": float("nan")})


def test_announced_episodes_are_demonstrated_and_judged(make_robot, make_teleop, clock, announce):
    """In the order of ``lerobot-record``: the operator connects first, sees each episode, and goes home."""
    robot, teleop = make_robot(clock=clock, seed=4), make_teleop()
    robot.connect()
    recorded = []
    for episode in range(2):
        announce(f"Recording episode {episode}")
        recorded.append(loop(robot, teleop, clock, 7.5))
        if episode == 0:
            announce("Reset the environment")
            loop(robot, teleop, clock, 1.5)
    robot.disconnect()
    assert robot.table.outcomes == [None, None]
    source = RecordSpec("me/arm", env="so_arm_sim").source()
    with source.open() as play:
        for seed, frames in zip((4, 5), recorded, strict=True):
            expected = play(seed).arrays["action"]
            np.testing.assert_allclose(values(frames)[: len(expected)], expected, atol=1e-3)
            np.testing.assert_allclose(values(frames)[0], HOME, atol=8)


def test_who_is_interrupted_goes_home_smoothly(make_robot, make_teleop, clock, announce):
    robot, teleop = make_robot(clock=clock), make_teleop()
    robot.connect()
    announce("Recording episode 0")
    away = values(loop(robot, teleop, clock, 3.0))[-1]
    announce("Reset the environment")
    back = values(loop(robot, teleop, clock, 1.5))
    assert np.abs(away - HOME).max() > 20
    np.testing.assert_allclose(back[0], away, atol=1)
    np.testing.assert_allclose(back[-1], HOME, atol=1e-9)
    assert np.abs(np.diff(back, axis=0)).max() < 8
    robot.disconnect()
    assert robot.table.outcomes == ["not placed", "no contact"]


def test_unannounced_demonstrations_follow_each_other(make_robot, make_teleop, clock):
    robot, teleop = make_robot(clock=clock, task="two_ways"), make_teleop(operator="brisk,hesitant")
    robot.connect()
    loop(robot, teleop, clock, 24.0)
    assert robot.table.seed >= 2
    assert robot.table.outcomes[:2] == [None, None]


def test_an_episode_of_the_robot_is_that_of_the_environment(make_robot, clock):
    """Replayed on the robot, a recorded episode succeeds: places and physics are the same."""
    source = RecordSpec("me/arm", env="so_arm_sim", task="stack").source()
    with source.open() as play:
        actions = play(7).arrays["action"]
    robot = make_robot(clock=clock, task="stack", seed=7)
    robot.connect()
    env = SoArmEnv(task="stack")
    env.reset(seed=7)
    np.testing.assert_allclose(robot.table.world.environment_state(), env.world.environment_state())
    for action in actions:
        robot.send_action(dict(zip(NAMES, action, strict=True)))
        clock.now += 1 / 30
    robot.disconnect()
    assert robot.table.outcomes == [None]


def test_the_operator_needs_a_robot_and_finds_it_by_its_id(make_robot, make_teleop, clock):
    teleop = make_teleop(robot_id="left")
    other = make_robot(clock=clock, id="right")
    with pytest.raises(DeviceNotConnectedError, match="no so_arm_sim robot with id left in this process"):
        teleop.get_action()
    make_robot(clock=clock, id="left")
    robot = make_robot(clock=clock, id="left")
    robot.connect()
    assert set(teleop.get_action()) == set(NAMES)
    assert not other.is_connected
    teleop.disconnect()
    with pytest.raises(DeviceNotConnectedError):
        teleop.get_action()


def test_the_motors_report_noise_when_asked(make_robot, clock):
    robot = make_robot(clock=clock, sensor_noise=0.5)
    robot.connect()
    seen = np.array([[robot.get_observation()[name] for name in NAMES] for _ in range(200)])
    np.testing.assert_allclose(seen.std(axis=0), 0.5, rtol=0.25)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"task": "fold"}, "unknown task 'fold'; choose one of: pick_place, stack, two_ways"),
        ({"cameras": {"top": CameraOptions()}}, "unknown camera 'top'; choose one of: front, wrist"),
        ({"cameras": {"front": CameraOptions(width=0)}}, "camera front cannot deliver 0 x 480 at 30 fps"),
        ({"camera_latency_s": -1.0}, "camera_latency_s is a number of seconds, 0 or more, got -1"),
        ({"seed": -1}, "seed is 0 or more, got -1"),
        ({"render_quality": "ultra"}, "unknown render_quality 'ultra'"),
    ],
    ids=lambda value: "" if isinstance(value, str) else next(iter(value)),
)
def test_robots_that_cannot_work_are_refused(options, message):
    with pytest.raises(ConfigurationError, match=message):
        SoArmSimConfig(**options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"frozen_camera": "top"}, "unknown frozen_camera 'top'; choose one of: front, wrist"),
        ({"blocked_joint": "knee"}, "unknown blocked_joint 'knee'; choose one of: shoulder_pan"),
        ({"dropped_frames": 1.0}, "dropped_frames is a share, 0 to below 1, got 1"),
        ({"loop_jitter_s": float("inf")}, "loop_jitter_s is a number of seconds"),
    ],
    ids=lambda value: "" if isinstance(value, str) else next(iter(value)),
)
def test_faults_that_cannot_be_are_refused(options, message):
    with pytest.raises(ConfigurationError, match=message):
        FaultOptions(**options)


def test_operators_that_do_not_exist_are_refused():
    with pytest.raises(ConfigurationError, match="unknown operator 'bob'"):
        SoArmTeleopConfig(operator="steady,bob")
    with pytest.raises(ConfigurationError, match="operator is empty"):
        SoArmTeleopConfig(operator="")
