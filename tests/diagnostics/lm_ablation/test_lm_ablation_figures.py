"""Effects with known answers, the verdict, and what is kept of a training."""

import re
from pathlib import Path

import numpy as np
import pytest

from lerobot_act_chunking.diagnostics.core.environments import EnvironmentSpec
from lerobot_act_chunking.diagnostics.lm_ablation.cells import CELLS, FACTORIAL
from lerobot_act_chunking.diagnostics.lm_ablation.effects import FACTORIAL_EFFECTS, effect
from lerobot_act_chunking.diagnostics.lm_ablation.matching import Match, match
from lerobot_act_chunking.diagnostics.lm_ablation.measuring import measure
from lerobot_act_chunking.diagnostics.lm_ablation.records import Record, Store
from lerobot_act_chunking.diagnostics.lm_ablation.settings import Budget, Settings
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.nn.language.encoder import TextEncoderSpec

SAME = Match({"bert": 1000, "mixer": 1010}, {"bert": 1000, "mixer": 1050})
CONDITION, EPISODES = "as demonstrated", 40


def settings(**changed):
    given = {"sizes": (5, 10), "seeds": (0, 1, 2), "budget": Budget(10, 2, 2, EPISODES, 1), **changed}
    return Settings("data", EnvironmentSpec("three_gates"), Path("nowhere"), **given)


def records(rates, seeds=(0, 1, 2), sizes=(5, 10)):
    """Trainings of cells with these success rates, the same in every seed and size."""
    return [
        Record(
            cell,
            size,
            seed,
            ((0, 1.0), (5, 0.5), (10, 0.2)),
            {CONDITION: tuple((np.arange(EPISODES) < rate * EPISODES).tolist())},
            {"mlp": 0.1},
            1.0,
        )
        for cell, rate in rates.items()
        for size in sizes
        for seed in seeds
    ]


RATES = dict(zip(FACTORIAL, (0.25, 0.75, 0.5, 0.5), strict=True))  # T-R, T-LM', M-R, M-LM'


@pytest.mark.parametrize(
    ("name", "value"), [("pretraining", 0.25), ("architecture", 0.0), ("interaction", 0.5)]
)
def test_the_effects_of_a_planted_two_by_two(name, value):
    found = effect(
        name, FACTORIAL_EFFECTS[name], records(RATES), CONDITION, [5, 10], np.random.default_rng(0)
    )
    assert found.value == pytest.approx(value)
    assert found.interval[0] <= value <= found.interval[1]
    assert found.decided == (value > 0)
    assert (found.seeds, found.size) == (3, None)


def test_training_seeds_that_differ_widen_the_interval():
    difference = {"T-LM": 1.0, "T-R": -1.0}
    widths = []
    for rates in ((0.5, 0.5, 0.5), (0.0, 0.5, 1.0)):
        trainings = records({"T-R": 0.5})
        trainings += [
            each for seed, rate in enumerate(rates) for each in records({"T-LM": rate}, seeds=(seed,))
        ]
        low, high = effect("x", difference, trainings, CONDITION, [5], np.random.default_rng(0)).interval
        widths.append(high - low)
    assert widths[0] < 0.05 < 0.5 < widths[1]


def test_an_effect_without_all_its_cells_is_none():
    some = records({"T-R": 0.5})
    assert (
        effect("x", FACTORIAL_EFFECTS["pretraining"], some, CONDITION, [5], np.random.default_rng(0)) is None
    )


@pytest.mark.parametrize(
    ("rates", "matched", "verdict", "reason"),
    [
        (RATES, SAME, "pass", "a pretrained start helps"),
        (dict.fromkeys(FACTORIAL, 0.5), SAME, "inconclusive", "not told apart from a random one"),
        ({"T-R": 0.5}, SAME, "inconclusive", "the two by two is not complete"),
        (RATES, Match({"bert": 100, "mixer": 103}, SAME.flops), "fail", "weights differ .* by 3.0 %"),
        (RATES, Match(SAME.parameters, {"bert": 100, "mixer": 80}), "fail", "work differ .* by 20.0 %"),
    ],
)
def test_the_verdict(rates, matched, verdict, reason):
    report = measure(settings(), records(rates), matched)
    assert report.verdict == verdict
    assert re.search(reason, report.reasons[0])
    row = report.rows[0]
    assert (row.trainings, row.learned_after, row.validation_loss) == (3, 10, pytest.approx(0.2))


def test_the_two_architectures_are_of_one_size_and_do_as_much_work():
    found = match(TextEncoderSpec(384, 12, 1536, 1, 0.0, 100, 16, 3))
    assert found.parameters_apart < 0.02
    assert found.flops_apart < 0.1


def test_a_training_comes_back_and_that_of_another_question_is_refused(tmp_path):
    store = Store(tmp_path, {"steps": 3})
    (kept,) = records({"T-LM'": 0.5}, seeds=(1,), sizes=(5,))
    store.keep(kept)
    (back,) = Store(tmp_path, {"steps": 3}).records()
    assert back.curve == kept.curve
    assert list(back.successes[CONDITION]) == list(kept.successes[CONDITION])
    with pytest.raises(ConfigurationError, match="trainings of another steps"):
        Store(tmp_path, {"steps": 4})
    store.path("T-LM'", 5, 1).write_text("{")
    with pytest.raises(ConfigurationError, match="remove it, and it is trained again"):
        list(store.records())


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"cells": ("T-X",)}, "unknown cell 'T-X'"),
        ({"policy": {"encoder_init": "random"}}, "what the cells differ in"),
        ({"shifts": ("words",)}, "a field of the environment and its value"),
        ({"sizes": ()}, "one size at least"),
        ({"text_tokens": 2}, "text_tokens=2 must be at least 3"),
    ],
)
def test_what_cannot_be_compared_is_refused(changed, message):
    with pytest.raises(ConfigurationError, match=message):
        settings(**changed)


def test_every_cell_says_what_it_is():
    assert len(
        {(each.architecture, each.init, each.training, each.student) for each in CELLS.values()}
    ) == len(CELLS)
    assert set(FACTORIAL) <= CELLS.keys()
