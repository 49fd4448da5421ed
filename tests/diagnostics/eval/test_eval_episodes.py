"""What is written down of an episode: standing still, labels of failures, times."""

import json

import numpy as np
import pytest

from lerobot_act_chunking.diagnostics.core.played import describe, standstill
from lerobot_act_chunking.diagnostics.core.rollouts import Inference, Rollout
from lerobot_act_chunking.diagnostics.eval.episodes import Group, Timing, timing_of

DT = 0.02
SWEEP = np.sin(np.linspace(0, 3, 100))[:, None] * np.array([1.0, 10.0, 0.0])


def rollout(motion=SWEEP, **facts):
    zeros = np.zeros(len(motion))
    given = {"rewards": zeros, "success": False, "states": motion, "ending": "cut", "acting_s": zeros}
    return Rollout(7, DT, motion, motion, **(given | facts))


def resting(steps, tremor=0.0):
    rest = np.repeat(SWEEP[-1:], steps, axis=0)
    return np.concatenate(
        [SWEEP, rest + tremor * (-1.0) ** np.arange(steps)[:, None] * np.ptp(SWEEP, axis=0)]
    )


@pytest.mark.parametrize("steps", [10, 50, 200])
def test_time_at_rest_is_counted_from_the_end(steps):
    # The last steps of the sweep are within the tolerance, too.
    assert steps * DT <= standstill(rollout(resting(steps))) <= (steps + 5) * DT
    assert standstill(rollout(resting(steps)[::-1])) < 5 * DT


def test_tremor_is_rest_and_swinging_is_not():
    assert standstill(rollout(resting(60, tremor=0.005))) >= 60 * DT
    assert standstill(rollout(resting(60, tremor=0.2))) < 2 * DT


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_rest_does_not_depend_on_units(scale):
    assert standstill(rollout(scale * resting(60))) == standstill(rollout(resting(60)))


def test_who_never_moves_rests_all_the_time():
    assert standstill(rollout(np.ones((30, 2)))) == pytest.approx(29 * DT)


def test_states_count_where_they_are_seen():
    still, moving = np.zeros((len(SWEEP), 2)), SWEEP
    assert standstill(rollout(moving, states=still)) > standstill(rollout(moving, states=moving))
    assert standstill(rollout(still, states=np.empty((len(SWEEP), 0)))) == pytest.approx(99 * DT)


@pytest.mark.parametrize(
    ("facts", "label", "stalled"),
    [
        ({"success": True, "failure": "dropped"}, None, False),
        ({"failure": "dropped"}, "dropped", False),
        ({"failure": "dropped", "states": np.zeros((100, 1))}, "dropped", True),
        ({"states": np.zeros((100, 1))}, "stalled", True),
        ({"states": np.zeros((100, 1)), "ending": "terminated"}, "terminated", True),
        ({"ending": "truncated"}, "timeout", False),
        ({"ending": "cut"}, "timeout", False),
        ({"ending": "terminated"}, "terminated", False),
    ],
)
def test_labels(facts, label, stalled):
    episode = describe(rollout(**facts), [0, 1])
    assert (episode.label, episode.stalled) == (label, stalled)


def test_rewards_lengths_and_smoothness():
    rewards = np.arange(100.0)
    episode = describe(rollout(rewards=rewards, rules={"success_hold": True}), [0, 1])
    assert (episode.sum_reward, episode.max_reward, episode.length) == (4950, 99, 100)
    assert episode.rules == {"success_hold": True}
    rough = describe(rollout(SWEEP + 0.05 * np.random.default_rng(0).standard_normal(SWEEP.shape)), [0, 1])
    assert rough.sparc < episode.sparc
    assert rough.log_dimensionless_jerk < episode.log_dimensionless_jerk
    assert describe(rollout(np.ones((30, 2))), [0]).sparc is None


def test_hands_do_not_count_as_jerk():
    shaking = SWEEP.copy()
    shaking[:, 1] = np.random.default_rng(0).standard_normal(100)
    without, with_hand = ([0], [0, 1])
    jerk = {
        (name, tuple(dims)): describe(motion, dims).log_dimensionless_jerk
        for name, motion in (("calm", rollout()), ("shaking", rollout(shaking)))
        for dims in (without, with_hand)
    }
    assert jerk["shaking", (0,)] == jerk["calm", (0,)]
    assert jerk["shaking", (0, 1)] < jerk["calm", (0, 1)]


def test_times_apart_by_whether_the_network_ran():
    times = np.full(100, 0.001)
    times[::25] = 0.02
    calls = tuple(Inference(step, np.empty((0, 3))) for step in range(0, 100, 25))
    short = rollout(SWEEP[:30], acting_s=times[:30], inferences=calls[:2])
    timing = timing_of([short, rollout(acting_s=times, inferences=calls)], 3.0)
    assert (timing.network_ms, timing.other_ms, timing.seconds) == (20.0, 1.0, 3.0)
    assert timing_of([rollout(acting_s=times)], 1.0).network_ms is None


def test_a_group_survives_json():
    group = Group((describe(rollout(rules={"a_success": False}), [0]),), Timing(1.5, None, 2.0))
    assert Group.from_json(json.loads(json.dumps(group.to_json()))) == group
