"""What is chosen: the present settings unless another is surely better, of the better ones the cheapest."""

import pytest

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.diagnostics.tune.candidates import Candidate
from lerobot_act_chunking.diagnostics.tune.racing import Race
from lerobot_act_chunking.diagnostics.tune.replay import Replay
from lerobot_act_chunking.diagnostics.tune.verdict import judge_race, judge_replay


def candidate(interval):
    settings = ExecutionSettings(chunk_size=20, execution="receding", replan_interval=interval)
    return Candidate((("execution", "receding"), ("replan_interval", interval)), settings)


PRESENT, OFTEN, SELDOM = candidate(1), candidate(2), candidate(10)
ALL = [PRESENT, OFTEN, SELDOM]


def raced(present, often, seldom, n=100):
    """With so many successes, in the first episodes of each."""
    counts = dict(zip(ALL, (present, often, seldom), strict=True))
    results = {each: [at < count for at in range(n)] for each, count in counts.items()}
    return Race(ALL, level=0.01, results=results)


def calls(candidate):
    return candidate.calls_per_second(20)


@pytest.mark.parametrize(
    ("successes", "verdict", "chosen"),
    [
        ((95, 95, 95), "pass", PRESENT),
        ((92, 95, 95), "pass", PRESENT),  # may be chance, and would not matter
        ((30, 90, 90), "warn", SELDOM),  # equally good: the cheaper one
        ((30, 90, 60), "warn", OFTEN),
        ((30, 90, 87), "warn", SELDOM),  # nearly as good
        ((84, 95, 10), "warn", OFTEN),
        ((0, 0, 0), "inconclusive", PRESENT),
    ],
)
def test_the_choice(successes, verdict, chosen):
    judgement = judge_race(raced(*successes), calls)
    assert (judgement.verdict, judgement.chosen) == (verdict, chosen)


def test_cheaper_and_close_but_surely_worse_than_the_best_is_not_chosen():
    """182 are 95.8 % of 190, but all eight episodes that only one of the two wins speak against it."""
    assert judge_race(raced(60, 190, 182, n=200), calls).chosen == OFTEN
    assert judge_race(raced(60, 190, 186, n=200), calls).chosen == SELDOM


def test_a_difference_that_would_matter_but_may_be_chance_is_left_open():
    judgement = judge_race(raced(4, 8, 2, n=10), calls)
    assert (judgement.verdict, judgement.chosen) == ("inconclusive", PRESENT)
    assert "8 of 10 episodes succeed with receding R=2 n=20, 4 with receding R=1 n=20" in judgement.reasons[0]
    assert "more --episodes" in judgement.reasons[0]


def test_how_sure_it_is_counts_all_comparisons():
    (reason,) = judge_race(raced(30, 90, 60), calls).reasons
    assert reason.endswith("corrected for 5 comparisons)")


def test_candidates_that_were_not_tried_are_told():
    race = raced(90, 90, 0)
    race.results[SELDOM] = []
    judgement = judge_race(race, calls)
    assert judgement.verdict == "inconclusive"
    assert "time ended before 1 candidates were tried" in judgement.reasons[0]
    assert "--minutes" in judgement.reasons[0]


def replayed(*distances):
    return {each: Replay(at, jump=at / 2, reaction_s=0.1) for each, at in zip(ALL, distances, strict=True)}


@pytest.mark.parametrize(
    ("distances", "chosen"),
    [((0.5, 0.495, 0.5), PRESENT), ((0.6, 0.5, 0.4), SELDOM), ((0.6, 0.401, 0.4), SELDOM)],
)
def test_replay_chooses_by_distance_and_says_that_it_is_weaker(distances, chosen):
    judgement = judge_replay(ALL, replayed(*distances), calls)
    assert (judgement.verdict, judgement.chosen) == ("warn", chosen)
    assert "a policy that stalls or drifts looks good in it" in judgement.reasons[-1]


def test_of_equal_distances_the_smaller_jumps_win():
    found = {
        PRESENT: Replay(0.9, 0.0, 0.1),
        OFTEN: Replay(0.5, 0.1, 0.1),
        SELDOM: Replay(0.498, 0.4, 0.1),
    }
    assert judge_replay(ALL, found, calls).chosen == OFTEN
