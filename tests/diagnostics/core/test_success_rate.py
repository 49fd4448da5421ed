import json

import pytest

from lerobot_act_chunking.diagnostics.core.eval_info import read_success_rate
from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate, mcnemar
from lerobot_act_chunking.errors import DatasetError


def test_wilson_interval_by_hand():
    # Wilson (1927): centre (p + z²/2n) / (1 + z²/n), half width z sqrt(p(1-p)/n + z²/4n²) / (1 + z²/n).
    low, high = SuccessRate(8, 10).interval
    assert low == pytest.approx(0.4902, abs=1e-4)
    assert high == pytest.approx(0.9433, abs=1e-4)


def test_certain_outcomes_keep_an_interval():
    assert SuccessRate(200, 200).interval[0] == pytest.approx(0.9812, abs=1e-4)
    assert SuccessRate(0, 200).interval[1] == pytest.approx(0.0188, abs=1e-4)


@pytest.mark.parametrize(("successes", "episodes"), [(3, 2), (-1, 2), (0, 0)])
def test_impossible_counts_are_refused(successes, episodes):
    with pytest.raises(ValueError, match=f"{successes} successes in {episodes} episodes"):
        SuccessRate(successes, episodes)


def test_the_same_failures_are_no_difference():
    assert mcnemar([1, 2, 3], [1, 2, 3]) == 1.0
    assert mcnemar([], []) == 1.0


def test_mcnemar_by_hand():
    # 8 episodes differ, 7 of them failed here alone: twice the tail (1 + 8) / 2 ** 8 of a fair coin.
    assert mcnemar([0, *range(1, 8)], [0, 9]) == pytest.approx(2 * 9 / 256, rel=1e-12)
    assert mcnemar([0, 9], [0, *range(1, 8)]) == pytest.approx(2 * 9 / 256, rel=1e-12)


def test_reads_lerobot_evals_file_over_all_tasks(tmp_path):
    tasks = [{"metrics": {"successes": [True, False]}}, {"metrics": {"successes": [True]}}]
    path = tmp_path / "eval_info.json"
    path.write_text(json.dumps({"per_task": tasks}))
    assert read_success_rate(path) == SuccessRate(2, 3)


def test_an_absent_or_foreign_file_is_named(tmp_path):
    with pytest.raises(DatasetError, match=r"no evaluation at .*eval_info\.json; run lerobot-eval"):
        read_success_rate(tmp_path / "eval_info.json")
    (tmp_path / "eval_info.json").write_text("[1, 2]")
    with pytest.raises(DatasetError, match=r"is not an eval_info\.json of lerobot-eval"):
        read_success_rate(tmp_path / "eval_info.json")
