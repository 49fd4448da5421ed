"""The three gates: what is seen, what the walls stop, and which gate counts."""

from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from hypothesis import given
from hypothesis import strategies as st

from lerobot_act_chunking.envs.three_gates.env import FAILURES, ThreeGatesEnv
from lerobot_act_chunking.envs.three_gates.world import GATES, LIMIT, OUTSIDE, RADIUS, START_RADIUS, gate_of
from lerobot_act_chunking.errors import ConfigurationError, FeatureError

GYM_ID = "three_gates/ThreeGates-v0"
SMALL = {"observation_height": 24, "observation_width": 32, "render_quality": "fast"}
ANGLES = (90, 210, 330)


@pytest.fixture
def make():
    """Make environments that are closed after the test."""
    made = []

    def build(**options):
        made.append(ThreeGatesEnv(**options))
        return made[-1]

    yield build
    for env in made:
        env.close()


def at(degrees, distance):
    angle = np.deg2rad(degrees)
    return distance * np.array([np.cos(angle), np.sin(angle)])


def push(env, target, steps=40):
    """Ask for one target again and again; the info at the end and how far the mass ever was."""
    furthest = 0.0
    for _ in range(steps):
        _, _, terminated, _, info = env.step(np.asarray(target, np.float32))
        furthest = max(furthest, np.hypot(*env.world.qpos()))
        if terminated:
            break
    return info, furthest


# Gymnasium would like bounds of observations, and actions in -1 .. 1; actions are positions.
@pytest.mark.filterwarnings("ignore:.*(minimum|maximum) value|.*symmetric and normalized space:UserWarning")
@pytest.mark.parametrize(
    "options",
    [{}, {"obs_type": "pixels", **SMALL}, {"obs_type": "pixels_state", "agent_vel": True, **SMALL}],
    ids=str,
)
def test_gymnasiums_checker_passes(options):
    env = gym.make(GYM_ID, visualization_height=24, visualization_width=32, **options)
    check_env(env.unwrapped)
    assert env.get_wrapper_attr("_max_episode_steps") == 40
    env.close()


@pytest.mark.parametrize(
    ("options", "shapes"),
    [
        ({}, {"agent_pos": (2,), "environment_state": (6,)}),
        ({"agent_vel": True}, {"agent_pos": (2,), "agent_vel": (2,), "environment_state": (6,)}),
        ({"obs_type": "pixels_state", **SMALL}, {"agent_pos": (2,), "pixels": (24, 32, 3)}),
        ({"obs_type": "pixels", **SMALL}, {"pixels": (24, 32, 3)}),
    ],
    ids=str,
)
def test_observations(make, options, shapes):
    observation, _ = make(**options).reset(seed=0)
    if "pixels" in shapes:
        observation["pixels"] = observation["pixels"]["top"]
    assert {name: value.shape for name, value in observation.items()} == shapes


def test_observations_are_the_worlds(make):
    env = make(agent_vel=True)
    env.reset(seed=1)
    observation = env.step(np.array([0.1, 0.0]))[0]
    assert np.array_equal(observation["agent_pos"], env.world.data.qpos)
    assert np.array_equal(observation["agent_vel"], env.world.data.qvel)
    assert observation["agent_vel"][0] > 0
    seen = observation["environment_state"].reshape(3, 2) + observation["agent_pos"]
    np.testing.assert_allclose(seen, GATES, atol=1e-12)
    before = observation["agent_pos"].copy()
    env.step(np.array([0.2, 0.0]))
    assert np.array_equal(observation["agent_pos"], before), "a copy"


def test_episodes_begin_at_rest_all_over_a_small_disc(make):
    env = make(agent_vel=True)
    observations = [env.reset(seed=seed)[0] for seed in range(300)]
    starts = np.stack([each["agent_pos"] for each in observations])
    distances = np.hypot(*starts.T)
    assert distances.max() <= START_RADIUS
    assert np.mean(distances < START_RADIUS / np.sqrt(2)) == pytest.approx(0.5, abs=0.1)
    assert np.abs(starts.mean(axis=0)).max() < 0.2 * START_RADIUS
    assert not np.any([each["agent_vel"] for each in observations])


def test_same_seed_same_episode_fresh_or_used(make):
    def trajectory(env, seed):
        env.reset(seed=seed)
        targets = np.random.default_rng(seed).uniform(-LIMIT, LIMIT, (30, 2))
        return np.stack([env.step(target)[0]["agent_pos"] for target in targets])

    used = make()
    first = trajectory(used, 3)
    assert np.array_equal(trajectory(make(), 3), first)
    assert np.array_equal(trajectory(used, 3), first)
    assert not np.array_equal(trajectory(used, 4), first)


@pytest.mark.parametrize(("mode", "angle"), [*enumerate(ANGLES)])
def test_through_a_gate_is_a_success_and_ends_the_episode(make, mode, angle):
    env = make()
    _, info = env.reset(seed=2)
    assert info == {"is_success": False, "mode": -1}
    modes = []
    for _ in range(10):
        _, reward, terminated, truncated, info = env.step(at(angle, 0.45))
        modes.append(info["mode"])
        assert terminated is info["is_success"] is (info["mode"] >= 0)
        assert reward == float(terminated)
        assert not truncated
        if terminated:
            break
    assert info == {"is_success": True, "mode": mode}
    assert set(modes[:-1]) == {-1}


@pytest.mark.parametrize("angle", [*range(120, 190, 10), *range(240, 310, 10), *range(0, 70, 10)])
def test_the_wall_stops_what_goes_between_the_gates(make, angle):
    """At once, and with the target beyond the wall for as long as an episode lasts."""
    env = make()
    env.reset(seed=4)
    info, furthest = push(env, at(angle, 0.5), steps=8)
    assert info == {"is_success": False, "mode": -1}
    assert RADIUS - 0.06 < furthest < RADIUS - 0.03


@pytest.mark.parametrize("middle", [30, 150, 270])
def test_the_mean_of_two_ways_never_gets_out(make, middle):
    env = make()
    for seed in range(5):
        env.reset(seed=seed)
        info, furthest = push(env, at(middle, LIMIT))
        assert info == {"is_success": False, "mode": -1}
        assert furthest < RADIUS - 0.03


@pytest.mark.parametrize(
    ("angle", "distance", "failure"),
    [
        (30, 0.1, "stayed inside"),
        (30, LIMIT, "met the wall"),
        (90, 0.1, "stayed inside"),
        (90, RADIUS, "stuck in a gate"),
        (90, LIMIT, None),
    ],
)
def test_how_far_an_episode_got(make, angle, distance, failure):
    env = make()
    env.reset(seed=4)
    push(env, at(angle, distance), steps=20)
    assert env.failure == failure
    assert failure in (*FAILURES, None)


def test_who_met_the_wall_and_left_it_did_not_stay_inside(make):
    env = make()
    env.reset(seed=4)
    push(env, at(30, LIMIT), steps=20)
    push(env, at(30, 0.0), steps=20)
    assert env.failure == "met the wall"
    env.reset(seed=4)
    assert env.failure == "stayed inside"


@given(st.floats(0, 360), st.floats(0, 0.7))
def test_the_gate_behind_which_a_position_is(angle, distance):
    position = at(angle, distance)
    away = [abs((angle - gate + 180) % 360 - 180) for gate in ANGLES]
    if min(abs(np.array(away) - 30)) < 1e-6 or abs(distance - OUTSIDE) < 1e-6:
        return
    expected = int(np.argmin(away)) if min(away) < 30 and distance > OUTSIDE else -1
    assert gate_of(position) == expected
    turned = at(angle + 120, distance)
    assert gate_of(turned) == (-1 if expected < 0 else (expected + 1) % 3)


def test_the_gates_are_equally_far_apart():
    sides = [np.linalg.norm(GATES[one] - GATES[other]) for one, other in ((0, 1), (1, 2), (2, 0))]
    np.testing.assert_allclose(sides, np.sqrt(3) * RADIUS)


def test_images_show_the_mass_where_it_is(make):
    env = make(obs_type="pixels", observation_height=120, observation_width=120, render_quality="fast")
    env.reset(seed=0)
    for target in (at(0, 0.15), at(180, 0.15)):
        for _ in range(8):
            observation = env.step(target)[0]
        image = observation["pixels"]["top"].astype(int)
        columns = np.nonzero(image[..., 0] - image[..., 1] > 60)[1]
        assert np.sign(columns.mean() - 60) == np.sign(target[0])
    assert env.render().shape == (480, 640, 3)
    assert make(render_mode=None).render() is None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"task": "two_gates"}, "unknown task 'two_gates'; choose one of: three_gates"),
        ({"success": "touch"}, "unknown success rule 'touch'; choose one of: outside"),
        ({"obs_type": "pixels", "cameras": ["side"]}, "unknown camera 'side'; choose one of: top"),
        ({"obs_type": "pixels", "agent_vel": True}, "agent_vel needs obs_type state or pixels_state"),
        ({"render_mode": "human"}, "unknown render_mode 'human'; choose one of: rgb_array, None"),
    ],
)
def test_options_that_cannot_work_are_refused(make, options, message):
    with pytest.raises(ConfigurationError, match=message):
        make(**options)


@pytest.mark.parametrize("action", [np.zeros(3), np.zeros((1, 2)), np.array([np.nan, 0.0])], ids=str)
def test_actions_that_cannot_work_are_refused(make, action):
    env = make()
    env.reset(seed=0)
    with pytest.raises(FeatureError, match="an action is a target x, y: two finite numbers"):
        env.step(action)


@pytest.mark.parametrize("vector", [gym.vector.SyncVectorEnv, gym.vector.AsyncVectorEnv])
def test_vector_environments_report_the_mode_of_each(vector):
    build = partial(gym.make, f"lerobot_act_chunking:{GYM_ID}", render_mode=None)
    extra = {"context": "forkserver"} if vector is gym.vector.AsyncVectorEnv else {}
    envs = vector([build] * 2, autoreset_mode=gym.vector.AutoresetMode.DISABLED, **extra)
    try:
        assert envs.reset(seed=[1, 2])[1]["mode"].tolist() == [-1, -1]
        terminated = np.zeros(2, bool)
        while not terminated.any():
            terminated, info = envs.step(np.stack([at(330, 0.45), at(150, 0.45)]))[2::2]
        assert info["mode"].tolist() == [2, -1]
        assert info["is_success"].tolist() == terminated.tolist() == [True, False]
    finally:
        envs.close()
