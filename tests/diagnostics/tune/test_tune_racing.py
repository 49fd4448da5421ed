"""Races on planted success tables: what is found, how often chance wins, and what it costs."""

import random

import pytest

from lerobot_act_chunking.diagnostics.tune.racing import ALPHA, Race, race, rounds_up_to


def planted(rates, seed, log=None, most_cells=None):
    """Candidates 0, 1, ... that succeed with these rates.

    In every second episode they succeed together, as policies do that meet the same difficulty.
    """

    def succeeds(candidate, episode):
        common = random.Random(f"{seed} {episode}").random()
        own = random.Random(f"{seed} {episode} {candidate}").random()
        return (common if episode % 2 else own) < rates[candidate]

    def evaluate(cells):
        for cell in cells:
            if most_cells is not None:
                if most_cells[0] == 0:
                    return
                most_cells[0] -= 1
            if log is not None:
                log.append(cell)
            episodes = range(cell.start, cell.start + cell.n)
            yield cell, [succeeds(cell.candidate, episode) for episode in episodes]

    return evaluate


def run(rates, seed=0, episodes=100, **options) -> Race:
    return race(range(len(rates)), planted(rates, seed, **options), episodes)


def test_rounds_double_up_to_the_most():
    assert rounds_up_to(100) == [25, 50, 100]
    assert rounds_up_to(130) == [25, 50, 100, 130]
    assert rounds_up_to(25) == [25]
    assert rounds_up_to(3) == [3]


@pytest.mark.parametrize("best", [1, 7, 19])
def test_the_best_is_found_from_a_bad_start(best):
    rates = [0.3] + [0.5] * 19
    rates[best] = 0.95
    found = run(rates)
    assert found.leader == best
    assert 0 in found.dropped
    assert found.is_worse(0, best)


def test_what_is_worse_costs_few_episodes():
    rates = [0.2] * 20 + [0.95]
    found = run(rates)
    assert found.leader == 20
    assert found.n_episodes < 0.6 * 100 * len(rates)


@pytest.mark.parametrize("rate", [0.3, 0.7])
def test_equal_candidates_are_rarely_told_apart(rate):
    n_races = 60
    unlike = sum(0 in run([rate] * 12, seed).dropped for seed in range(n_races))
    assert unlike <= 3 * ALPHA * n_races / 2


def test_no_more_than_the_worse_half_goes_at_once():
    log = []
    run([0.9] + [0.0] * 15, log=log)
    second = {cell.candidate for cell in log if cell.start == 25}
    assert len(second) == 8
    assert 0 in second


def test_present_settings_that_nearly_always_succeed_end_the_search():
    found = run([1.0, 0.5, 1.0])
    assert found.settled
    assert found.n_episodes == 50
    assert not run([0.8, 0.5, 1.0]).settled


def test_one_candidate_alone_needs_no_further_round():
    assert run([0.5]).n_episodes == 50


def test_time_that_ends_leaves_what_was_measured():
    found = run([0.6] * 6, most_cells=[5])  # two of the present settings, then three others
    assert not found.complete
    assert [len(found.results[each]) for each in range(6)] == [50, 25, 25, 25, 0, 0]
    assert set(found.running) == {0, 1, 2, 3}


def test_nothing_at_all_in_no_time():
    found = run([0.6] * 3, most_cells=[0])
    assert (found.complete, found.n_episodes, found.running) == (False, 0, [])


def test_only_common_episodes_are_compared():
    found = Race(
        candidates=["a", "b"], level=0.05, results={"a": [True] * 25 + [False] * 25, "b": [True] * 25}
    )
    assert found.both("a", "b") == (25, 25)
    assert found.p_value("a", "b") == 1.0
    assert found.running == ["b", "a"]


def test_every_candidate_meets_every_episode_once():
    log = []
    run([0.5, 0.6, 0.7], log=log)
    for candidate in range(3):
        seen = [
            at for cell in log if cell.candidate == candidate for at in range(cell.start, cell.start + cell.n)
        ]
        assert seen == list(range(len(seen)))
