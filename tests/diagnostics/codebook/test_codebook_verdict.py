"""When a codebook passes, and what is said if it does not."""

import pytest
from codebook_fakes import subject

from lerobot_act_chunking.diagnostics.codebook.drift import Drift
from lerobot_act_chunking.diagnostics.codebook.losses import Loss, Losses
from lerobot_act_chunking.diagnostics.codebook.settings import Thresholds
from lerobot_act_chunking.diagnostics.codebook.usage import LevelUsage, Usage
from lerobot_act_chunking.diagnostics.codebook.verdict import judge
from lerobot_act_chunking.errors import ConfigurationError


def usage(*, dead=0, chunks=400):
    even = LevelUsage([100] * 8, 8.0)
    poor = LevelUsage([0] * dead + [100] * (8 - dead), 8.0 - dead)
    return Usage([even, poor], 8, 30, chunks)


def losses(lost=0.02, **by_dimension):
    dimensions = [Loss(name, 0.1, 0.2, share) for name, share in by_dimension.items()]
    return Losses(dimensions, [], "raw units", [], lost)


def drift(*, distance=0.1, expected=0.1, error_ratio=1.0, beyond=0.01):
    return Drift("other", 300, [0.05, distance], expected, error_ratio, beyond)


def judged(*, dead=0, chunks=400, lost=0.02, drifted=None, by_dimension=None, unfinished=None, **settings):
    found = judge(
        subject(unfinished=unfinished, **settings),
        usage(dead=dead, chunks=chunks),
        losses(lost, **(by_dimension or {})),
        drifted,
        Thresholds(),
    )
    return found.verdict, "; ".join(found.reasons)


def test_nothing_to_find():
    assert judged() == ("pass", "the codes are in use and tell 98% of what varies")
    verdict, reasons = judged(drifted=drift())
    assert verdict == "pass"
    assert reasons.endswith("other fits them as the training data do")


def test_few_chunks_cannot_be_judged():
    verdict, reasons = judged(chunks=255, dead=7)
    assert verdict == "inconclusive"
    assert "255 chunks are too few" in reasons
    assert "more demonstrations as --dataset" in reasons


@pytest.mark.parametrize(("dead", "verdict"), [(2, "pass"), (3, "warn"), (4, "warn"), (5, "fail")])
def test_dead_codes(dead, verdict):
    found, reasons = judged(dead=dead)
    assert found == verdict
    if dead > 2:
        assert f"{dead} of the 8 codes of level 2 are never used" in reasons
        assert "train the tokenizer for longer, take fewer codes" in reasons


def test_what_revives_dead_codes_depends_on_what_was_tried():
    _, reasons = judged(dead=5, kmeans_iters=0)
    assert "place them by k-means (--policy.kmeans_iters=20), or take --policy.tokenizer=fsq" in reasons
    _, reasons = judged(dead=5, kmeans_iters=0, dead_code_threshold=0)
    assert "kmeans_iters=20) and revive them (--policy.dead_code_threshold=" in reasons
    _, reasons = judged(dead=5, tokenizer="fsq")
    assert "smaller --policy.fsq_levels" in reasons
    assert judged(dead=7, tokenizer="uniform")[0] == "pass"


@pytest.mark.parametrize(("lost", "verdict"), [(0.1, "pass"), (0.11, "warn"), (0.51, "fail")])
def test_coarse_codes(lost, verdict):
    found, reasons = judged(lost=lost)
    assert found == verdict
    if verdict != "pass":
        assert f"lose {lost:.0%} of what varies" in reasons
        assert "more levels (--policy.vqvae_num_layers)" in reasons
        assert "shorter chunks" in reasons


def test_finer_bins_are_not_trained():
    _, reasons = judged(lost=0.2, tokenizer="dct")
    assert "more coefficients (--policy.dct_coefficients)" in reasons
    assert "training" not in reasons


def test_a_dimension_that_no_code_tells():
    verdict, reasons = judged(by_dimension={"waist": 1.2, "elbow": 0.5, "roll": None})
    assert verdict == "warn"
    assert "they hardly tell waist (100% lost): ways that differ in these alone" in reasons
    assert "elbow" not in reasons
    assert "more levels" in reasons


def test_an_unfinished_tokenizer():
    verdict, reasons = judged(unfinished="3 of 500 steps")
    assert verdict == "fail"
    assert "has learned for 3 of 500 steps: resume the training" in reasons


@pytest.mark.parametrize(
    ("other", "verdict", "message"),
    [
        (
            {"distance": 0.31},
            "warn",
            "other uses other codes than the training data: Jensen-Shannon distance 0.31",
        ),
        ({"distance": 0.31, "expected": 0.2}, "pass", "other fits"),
        ({"distance": 0.21, "expected": None}, "warn", "differ by 0.00 among themselves"),
        ({"error_ratio": 1.6}, "warn", "errors there are 1.6 times"),
        ({"error_ratio": 3.1}, "fail", "errors there are 3.1 times"),
        ({"beyond": 0.06}, "warn", "6% of its chunks have errors"),
        ({"beyond": 0.21}, "fail", "do not have; train the tokenizer and the policy on both"),
    ],
)
def test_drift(other, verdict, message):
    found, reasons = judged(drifted=drift(**other))
    assert found == verdict
    assert message in reasons


def test_the_worst_comes_first():
    verdict, reasons = judged(dead=3, lost=0.6)
    assert verdict == "fail"
    assert reasons.index("lose 60%") < reasons.index("never used")


def test_what_may_be_lost_is_an_option():
    assert Thresholds.with_max_lost(0.2).lost_variance == (0.2, 0.5)
    assert Thresholds.with_max_lost(0.7).lost_variance == (0.7, 0.7)
    for share in (0, 1, -0.1):
        with pytest.raises(ConfigurationError, match=f"max_lost={share} must be between 0 and 1"):
            Thresholds.with_max_lost(share)
