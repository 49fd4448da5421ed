"""The answer in words: which cause is named first, and when none is."""

from types import SimpleNamespace

import pytest

from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate
from lerobot_act_chunking.diagnostics.diagnose.causes import Finding
from lerobot_act_chunking.diagnostics.diagnose.effects import Effect, rank
from lerobot_act_chunking.diagnostics.diagnose.looking import Seen
from lerobot_act_chunking.diagnostics.diagnose.measuring import Measured
from lerobot_act_chunking.diagnostics.diagnose.starts import Outside
from lerobot_act_chunking.diagnostics.diagnose.trials import Trial
from lerobot_act_chunking.diagnostics.diagnose.verdict import judge

WEAK = Finding("under-training or too little data", True, "It is far off.", "train for longer")
RANGE = Finding("data range", True, "They start outside.", "record more")
CERTAIN = Finding("untrained", True, "Initial weights.", "train", certain=True)
OUTSIDE = Outside((18, 20), (0, 80), 1e-9, "goal[0]")


def seen(*findings, outside=None):
    return Seen(list(findings), None, None, False, outside)


def effect(hypothesis="latency", recovered=20):
    failing = {seed: seed < recovered for seed in range(20)}
    trial = Trial(hypothesis, "it", "--policy.latency_steps=0")
    return Effect(trial, failing, dict.fromkeys(range(100, 180), True), {}, 20, 80)


def measured(failures=20, episodes=100, effects=(), **facts):
    records = [
        SimpleNamespace(episode=SimpleNamespace(success=number >= failures)) for number in range(episodes)
    ]
    return Measured(records, rank(list(effects)) if effects else None, **facts)


def names(judgement):
    return [each.name for each in judgement.causes]


@pytest.mark.parametrize(
    ("failures", "episodes", "verdict", "words"),
    [
        (0, 100, "pass", "healthy"),
        (2, 100, "pass", "healthy"),
        (3, 100, "inconclusive", "3 failures are too few: run more --episodes"),
        (0, 50, "inconclusive", "0 failures are too few"),
        (20, 100, "inconclusive", "none of these"),
    ],
)
def test_few_failures_and_no_cause(failures, episodes, verdict, words):
    judgement = judge(measured(failures, episodes), seen())
    assert judgement.verdict == verdict
    assert words in judgement.reasons[0]
    assert judgement.causes == []


def test_no_episode_is_no_answer():
    assert "time ended" in judge(measured(0, 0), seen()).reasons[0]


def test_an_intervention_that_helps_is_named_with_its_repair():
    judgement = judge(measured(effects=[effect()]), seen())
    assert judgement.verdict == "fail"
    assert names(judgement) == ["latency"]
    assert "20 of 20 failing episodes succeed" in judgement.reasons[0]
    assert judgement.causes[0].repair == "--policy.latency_steps=0"


def test_what_is_certain_comes_first():
    assert names(judge(measured(effects=[effect()]), seen(CERTAIN, WEAK))) == ["untrained"]


def test_what_explains_most_comes_first():
    both = judge(measured(effects=[effect(recovered=12)]), seen(RANGE, outside=OUTSIDE))
    assert names(both) == ["data range", "latency"]
    assert OUTSIDE.share == pytest.approx(18 / 20 - 18 * 2 / 82 / 20)
    both = judge(measured(effects=[effect()]), seen(RANGE, outside=OUTSIDE))
    assert names(both) == ["latency", "data range"]


def test_weak_training_gives_way_to_what_repairs_nearly_all():
    assert names(judge(measured(effects=[effect()]), seen(WEAK))) == ["latency"]
    half = judge(measured(effects=[effect(recovered=11)]), seen(WEAK))
    assert names(half) == ["under-training or too little data", "latency"]
    assert names(judge(measured(), seen(WEAK))) == ["under-training or too little data"]


def test_luck_of_the_draw():
    drawn = measured(repetition=SuccessRate(16, 20))
    assert names(judge(drawn, seen())) == ["wrong mode"]
    assert names(judge(measured(repetition=SuccessRate(4, 20)), seen())) == []


def test_luck_that_repairs_nearly_all_comes_before_weak_training():
    assert names(judge(measured(repetition=SuccessRate(16, 20)), seen(WEAK))) == ["wrong mode"]
    half = judge(measured(repetition=SuccessRate(11, 20)), seen(WEAK))
    assert names(half) == ["under-training or too little data"]


def test_luck_of_the_draw_names_the_way_of_drawing_that_does_as_well():
    failing = dict.fromkeys(range(20), True)
    repetition = {seed: seed >= 3 for seed in range(20)}
    trial = Trial("wrong mode", "the likeliest latent", "--policy.z_inference=mode")
    as_good = Effect(trial, failing, dict.fromkeys(range(100, 180), True), repetition, 20, 80)
    assert as_good.p_value > 0.05  # it cannot be told from luck
    judgement = judge(measured(effects=[as_good], repetition=SuccessRate(17, 20)), seen(WEAK))
    assert names(judgement) == ["wrong mode"]
    assert judgement.causes[0].repair == "--policy.z_inference=mode"
    assert "With the likeliest latent, 20 of 20 failing episodes succeed" in judgement.causes[0].evidence


def test_without_an_environment():
    assert judge(None, seen()).verdict == "inconclusive"
    assert "--env.type" in judge(None, seen()).reasons[0]
    judgement = judge(None, seen(WEAK))
    assert (judgement.verdict, names(judgement)) == ("fail", ["under-training or too little data"])


def test_unfinished_is_said():
    assert "run the same command again" in judge(measured(complete=False), seen()).reasons[0]
