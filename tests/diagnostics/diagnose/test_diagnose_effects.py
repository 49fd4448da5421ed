"""What an intervention does beyond chance and harm, and which one is named of those that help."""

import numpy as np
import pytest

from lerobot_act_chunking.diagnostics.diagnose.effects import LEVEL, Effect, rank
from lerobot_act_chunking.diagnostics.diagnose.trials import Trial


def trial(hypothesis="over-smoothing", size=1, **changes):
    return Trial(hypothesis, hypothesis, values=tuple(changes.items()), size=size)


def effect(recovered, broken=0, *, failing=20, controls=80, again=0, successes=80, which=None, **named):
    failures = range(failing)
    return Effect(
        trial=which or trial(**named),
        failing={seed: seed < recovered for seed in failures},
        controls={1000 + seed: seed >= broken for seed in range(controls)},
        repetition={seed: seed >= failing - again for seed in failures} if again else {},
        n_failures=failing,
        n_successes=successes,
    )


def test_what_repairs_all_and_breaks_nothing_is_sure():
    found = effect(20)
    assert found.net == 1
    assert found.p_value < 1e-4
    assert rank([found]).cause is found


def test_what_repairs_little_is_not():
    assert rank([effect(3)]).cause is None
    assert rank([effect(0)]).cause is None


def test_repetition_and_harm_count_against_it():
    assert effect(12, again=6).net == pytest.approx(0.3)
    # 4 of 20 successes break: of all 80 as many as 16 of the 20 failures
    assert effect(12, 4, controls=20).net == pytest.approx(12 / 20 - 16 / 20)
    assert effect(12, 4, controls=20).p_value > LEVEL
    assert effect(20, 0, controls=8).p_value > LEVEL  # too few to know what breaks
    assert effect(12, 0).p_value < LEVEL


def test_what_a_repetition_repairs_as_well_is_chance():
    assert effect(10, again=10, controls=0).p_value > LEVEL
    assert effect(18, again=2, controls=0).p_value < LEVEL


def test_without_successes_repetition_alone_counts():
    found = effect(10, controls=0, successes=0)
    assert found.broken is None
    assert found.harm == 0
    assert found.p_value < LEVEL


def test_luck_is_hardly_ever_called_a_cause():
    """An intervention that rolls the dice anew, for policies of every success rate."""
    rng = np.random.default_rng(0)
    named = tried = 0
    for _ in range(1500):
        rate = rng.uniform(0.3, 0.9)
        before, after = rng.random(100) < rate, rng.random(100) < rate
        failing, controls = np.flatnonzero(~before)[:40], np.flatnonzero(before)[:60]
        if len(failing) < 10:
            continue
        found = Effect(
            trial(),
            {int(each): bool(after[each]) for each in failing},
            {int(each): bool(after[each]) for each in controls},
            {},
            int((~before).sum()),
            int(before.sum()),
        )
        tried += 1
        named += rank([found]).cause is not None
    assert tried > 1000
    assert named / tried < LEVEL


def test_of_those_that_help_alike_the_smallest_is_named():
    large, small = effect(20, size=2, hypothesis="chunk too short"), effect(18, size=1)
    assert rank([large, small]).cause is small
    assert rank([large, effect(8, size=1)]).cause is large


def test_a_further_cause_repairs_what_the_first_does_not():
    first = effect(14)
    rest = {seed: seed >= 12 for seed in range(20)}
    other = Effect(trial("latency"), rest, first.controls, {}, 20, 80)
    ranking = rank([first, other])
    assert ranking.cause is first
    assert ranking.further == [other]
    assert rank([effect(20), other]).further == []


def test_many_interventions_are_corrected_for():
    one = effect(6, controls=0, successes=0)
    assert one.p_value < LEVEL
    assert rank([one, *(effect(0, hypothesis="jitter", step=n) for n in range(9))]).cause is None
