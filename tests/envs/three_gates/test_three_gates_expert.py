"""The expert of the three gates: through the gate that it is told, whatever its options."""

from dataclasses import fields

import numpy as np
import pytest
from tiers import draws

from lerobot_act_chunking.envs.demonstration import ExpertOptions
from lerobot_act_chunking.envs.operators import OPERATORS, get_operator
from lerobot_act_chunking.envs.three_gates.env import ThreeGatesEnv
from lerobot_act_chunking.envs.three_gates.expert import RANGES, plan
from lerobot_act_chunking.envs.three_gates.world import GATES
from lerobot_act_chunking.errors import ConfigurationError

STEPS = 40  # of an episode
START = np.array([0.01, -0.02])
LIMITS = [{name: value} for name, limits in RANGES.items() for value in limits[:2]]

every_mode = pytest.mark.parametrize("mode", range(3))


@pytest.fixture(scope="module")
def env():
    return ThreeGatesEnv(render_mode=None)


def planned(seed=0, mode=0, start=START, **options):
    return plan(start, ExpertOptions(**options), np.random.default_rng(seed), mode=mode)


def outcome(env, seed, mode, options):
    env.reset(seed=seed)
    _, commands = plan(env.world.qpos(), options, np.random.default_rng(seed), mode=mode)
    for command in commands:
        info = env.step(command)[-1]
    return info["is_success"], info["mode"]


@every_mode
@pytest.mark.parametrize("options", [{}, *LIMITS], ids=str)
def test_the_expert_goes_the_way_it_is_told(env, mode, options):
    n_seeds = draws(gate=30, full=1000)
    found = [outcome(env, seed, mode, ExpertOptions(**options)) for seed in range(n_seeds)]
    assert found.count((True, mode)) >= 0.99 * n_seeds
    assert {way for _, way in found} <= {mode, -1}


@pytest.mark.parametrize("operator", OPERATORS)
def test_every_person_can_go_every_way(env, operator):
    rng = np.random.default_rng(0)
    for seed in range(30):
        options = get_operator(operator).episode(rng, RANGES)
        assert outcome(env, seed, seed % 3, options) == (True, seed % 3)


def test_plans_fit_an_episode_and_end_behind_the_gate():
    for options in LIMITS:
        actions, commands = planned(**options)
        assert actions.shape == commands.shape
        assert 10 <= len(actions) <= STEPS
    actions, commands = planned(mode=1)
    np.testing.assert_allclose(actions[-1], 1.5 * GATES[1])
    np.testing.assert_array_equal(actions, commands)


@every_mode
def test_the_ways_differ_by_a_turn_alone(mode):
    turn = np.deg2rad(120 * mode)
    matrix = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    turned = planned(mode=0)[0] @ matrix.T
    np.testing.assert_allclose(planned(mode=mode, start=matrix @ START)[0], turned, atol=1e-12)


def test_noise_free_plans_draw_nothing():
    rng = np.random.default_rng(7)
    plan(START, ExpertOptions(), rng)
    assert rng.bit_generator.state == np.random.default_rng(7).bit_generator.state


def test_action_noise_disturbs_commands_and_not_labels():
    actions, commands = planned(action_noise=0.01)
    np.testing.assert_array_equal(actions, planned()[0])
    assert 0.003 < (commands - actions).std() < 0.02
    again, other = planned(action_noise=0.01)[1], planned(seed=1, action_noise=0.01)[1]
    np.testing.assert_array_equal(commands, again)
    assert np.abs(commands - other).max() > 1e-3


def test_hand_noise_is_recorded_and_executed():
    actions, commands = planned(hand_noise=0.01)
    np.testing.assert_array_equal(actions, commands)
    assert np.abs(actions - planned()[0]).max() > 1e-3


def test_way_point_noise_is_gone_at_the_gate():
    straight, around = planned()[0], planned(waypoint_noise=0.03)[0]
    away = np.linalg.norm(around - straight, axis=1)
    beyond = np.linalg.norm(straight, axis=1) > np.linalg.norm(GATES[0])
    assert away[~beyond].max() > 0.003
    assert away[beyond].max() < 1e-12


def test_a_rest_and_the_pace_change_the_length():
    rested, plain = planned(idle_start=0.3)[0], planned()[0]
    np.testing.assert_array_equal(rested[:3], np.tile(START, (3, 1)))
    np.testing.assert_array_equal(rested[3:], plain)
    assert len(planned(speed=1.1)[0]) == round(len(plain) / 1.1)


def test_what_the_expert_does_not_do_is_refused():
    assert {entry.name for entry in fields(ExpertOptions)} == set(RANGES)
    with pytest.raises(ConfigurationError, match=r"dwell=0\.5 is outside 0\.0 \.\. 0\.0 in three_gates"):
        planned(dwell=0.5)
    with pytest.raises(ConfigurationError, match="unknown mode of three_gates 3; choose one of: 0, 1, 2"):
        planned(mode=3)
