"""Which of several policies succeeds more often, from what lerobot-eval wrote."""

import json

import numpy as np
import pytest
from rich.console import Console
from scipy.stats import ttest_ind

from lerobot_act_chunking.diagnostics.compare.diagnosis import diagnose
from lerobot_act_chunking.diagnostics.compare.plots import plot_report
from lerobot_act_chunking.diagnostics.compare.settings import Recipe, Settings, parse_policy
from lerobot_act_chunking.diagnostics.compare.terminal import print_report
from lerobot_act_chunking.diagnostics.compare.trials import Trials, contrast
from lerobot_act_chunking.errors import ConfigurationError, DatasetError


def evaluation(folder, *tasks, group="aloha"):
    """What lerobot-eval writes, of one list of successes per task."""
    folder.mkdir(parents=True)
    per_task = [
        {"task_group": group, "task_id": place, "metrics": {"successes": [bool(each) for each in successes]}}
        for place, successes in enumerate(tasks)
    ]
    (folder / "eval_info.json").write_text(json.dumps({"per_task": per_task}))
    return folder


def successes(rate, n=200, seed=0):
    return np.random.default_rng(seed).random(n) < rate


def compare(*texts, paired=True):
    return diagnose(Settings(tuple(parse_policy(str(each)) for each in texts), paired))


def card_of(report):
    console = Console(width=200, record=True)
    print_report(report, console)
    return console.export_text()


def test_the_better_one_is_found_and_comes_first(tmp_path):
    worse, better = (
        evaluation(tmp_path / name, successes(rate)) for name, rate in (("worse", 0.6), ("better", 0.9))
    )
    report = compare(worse, better)
    assert [each.name for each in report.trials] == ["better", "worse"]
    assert list(report.letters) == ["a", "b"]
    assert (report.verdict, report.exit_code) == ("pass", 0)
    (found,) = report.contrasts
    # The same draws: whatever the worse one did, the better one did, too.
    assert (found.kind, found.pairs.only_second) == ("paired", 0)
    assert (
        f"better succeeds more often than worse: by {100 * found.difference:.1f} points" in report.reasons[0]
    )


def test_alike_policies_are_not_told_apart_and_the_card_says_what_would(tmp_path):
    one, other = (
        evaluation(tmp_path / name, successes(rate, 50, seed))
        for name, rate, seed in (("one", 0.8, 1), ("other", 0.7, 2))
    )
    report = compare(one, other)
    assert (report.verdict, report.exit_code, list(report.letters)) == ("inconclusive", 10, ["a", "a"])
    assert "are not told apart: 50 episodes show differences of about" in report.reasons[0]
    (found,) = report.contrasts
    needed = int(report.reasons[0].split("about ")[-1].split()[0])
    assert needed == pytest.approx(50 * (found.smallest / found.difference) ** 2, rel=0.11)


def test_few_episodes_show_nothing(tmp_path):
    places = [evaluation(tmp_path / name, [True] * 4) for name in "ab"]
    report = compare(*places)
    assert "4 episodes are too few to show any difference" in report.reasons[0]
    assert "150" not in card_of(report)


def test_the_smallest_difference_is_found_in_four_of_five_studies():
    rng, n, found = np.random.default_rng(0), 200, []
    first, second = 0.75, 0.6
    smallest = []
    for _ in range(300):
        pair = [
            Trials(name, ({("", 0, i): bool(x) for i, x in enumerate(rng.random(n) < rate)},))
            for name, rate in (("a", first), ("b", second))
        ]
        each = contrast(*pair, paired=True)
        found.append(each.p_value < 0.05)
        smallest.append(each.smallest)
    assert np.mean(smallest) == pytest.approx(0.13, abs=0.01)
    assert 0.8 < np.mean(found) < 0.95  # 15 points, a little above the smallest


def test_a_handful_of_episodes_shows_no_small_difference(tmp_path):
    folders = [evaluation(tmp_path / name, [1] * 10) for name in ("one", "other")]
    assert compare(*folders).contrasts[0].smallest == 6 / 10  # the exact test needs six that all say the same


def test_training_seeds_that_differ_are_compared_by_welchs_test():
    rates = ((180, 120, 150), (90, 120, 60))
    trials = [
        Trials(name, tuple({("", 0, i): i < count for i in range(200)} for count in counts))
        for name, counts in zip("ab", rates, strict=True)
    ]
    found = contrast(*trials, paired=True)
    first, second = (np.array(counts) / 200 for counts in rates)
    expected = ttest_ind(first, second, equal_var=False)
    assert found.p_value == pytest.approx(expected.pvalue)
    interval = expected.confidence_interval()
    assert found.interval == pytest.approx((interval.low, interval.high))


def test_the_others_need_not_be_told_apart_from_each_other(tmp_path):
    rates = {"best": 0.95, "b": 0.6, "c": 0.55}
    folders = [
        evaluation(tmp_path / name, successes(rate, seed=seed))
        for seed, (name, rate) in enumerate(rates.items())
    ]
    report = compare(*folders)
    assert (report.verdict, list(report.letters), len(report.reasons)) == ("pass", ["a", "b", "b"], 2)
    assert report.adjusted[-1] < 1


def test_three_policies_are_corrected_for_three_comparisons(tmp_path):
    folders = [evaluation(tmp_path / f"p{rate}", successes(rate / 100, seed=rate)) for rate in (50, 70, 90)]
    report = compare(*folders)
    assert len(report.contrasts) == 3
    assert all(p >= each.p_value for p, each in zip(report.adjusted, report.contrasts, strict=True))
    assert list(report.letters) == ["a", "b", "c"]
    # Three bets: one of them reaches 60 by chance in at most 5 % of the studies.
    assert "go by the e-value: 60 or more (20 for each comparison" in card_of(report)


def test_training_seeds_are_a_level_of_their_own(tmp_path):
    rates = {"a": (0.9, 0.5, 0.7), "b": (0.6, 0.7, 0.65)}
    names = {}
    for name, each in rates.items():
        folders = [
            evaluation(tmp_path / f"{name}{i}", successes(rate, seed=i)) for i, rate in enumerate(each)
        ]
        names[name] = f"{name}={','.join(map(str, folders))}"
    report = compare(*names.values())
    (found,) = report.contrasts
    assert (found.kind, found.pairs, report.verdict) == ("training seeds", None, "inconclusive")
    # Pooled, 600 episodes each would have told them apart: the seeds of `a` differ by far more than chance.
    apart = report.trials[0].seeds_apart, report.trials[0].episodes_apart
    assert apart[0] > 4 * apart[1]
    assert -1 <= found.interval[0] < 0 < found.interval[1] <= 1
    assert "3 and 3 training seeds show differences of about" in report.reasons[0]
    card = card_of(report)
    assert card.count(" of 200") == 6
    assert "e-value" not in card


def test_seeds_that_agree_by_chance_are_not_taken_for_certain(tmp_path):
    same = successes(0.8)
    first = [evaluation(tmp_path / f"a{i}", same) for i in range(2)]
    second = [evaluation(tmp_path / f"b{i}", successes(0.77, seed=5)) for i in range(2)]
    report = compare(f"a={first[0]},{first[1]}", f"b={second[0]},{second[1]}")
    assert report.verdict == "inconclusive"
    assert report.contrasts[0].p_value > 0.05


def test_who_is_named_first_does_not_matter(tmp_path):
    folders = [evaluation(tmp_path / name, successes(0.8, seed=i)) for i, name in enumerate("abc")]
    assert compare(*folders).content() == compare(*reversed(folders)).content()


def test_evaluations_of_other_episodes_are_not_paired(tmp_path):
    one, other = (
        evaluation(tmp_path / name, successes(rate, n))
        for name, rate, n in (("one", 0.9, 200), ("other", 0.5, 100))
    )
    (found,) = compare(one, other, paired=False).contrasts
    assert (found.kind, found.pairs) == ("independent", None)
    assert found.p_value < 1e-6
    paired = compare(one, other)
    assert paired.contrasts[0].pairs.n == 100
    assert "one and other are compared by the 100 episodes that both have." in paired.notes


def test_tasks_of_a_suite_are_paired_with_themselves(tmp_path):
    one = evaluation(tmp_path / "one", [1, 1, 0], [0, 0])
    other = evaluation(tmp_path / "other", [1, 1, 0], [0, 1])
    pairs = compare(one, other).contrasts[0].pairs
    assert (pairs.both, pairs.only_first, pairs.only_second, pairs.neither) == (2, 1, 0, 2)


def test_numbers_pictures_and_cards(tmp_path):
    folders = [evaluation(tmp_path / name, successes(0.7, seed=i)) for i, name in enumerate(("[odd]", "b"))]
    report = compare(*folders)
    content = json.loads(report.write(tmp_path / "c.json").read_text())
    assert content["tool"] == "compare"
    assert {each["name"] for each in content["policies"]} == {"[odd]", "b"}
    (found,) = content["contrasts"]
    assert found["e_value"] > 0
    assert found["p_holm"] == found["p_value"]
    assert content["policies"][0]["trainings"][0]["episodes"] == 200
    assert plot_report(report, tmp_path / "new" / "c.png").stat().st_size > 10_000
    card = card_of(report)
    assert "[odd]" in card
    assert "go by the e-value: 20 or more." in card


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (["a"], "compare takes two policies or more"),
        (["=a", "b"], "'=a' is no evaluation: give NAME=PATH"),
        (["x=", "b"], "'x=' is no evaluation: give NAME=PATH"),
        (["x=a", "x=b"], "2 policies are named x: give other names"),
        (["x=a", "y=a"], "a/eval_info.json is given 2 times"),
        (["x=a,b", "c"], "training seeds: x 2, c 1"),
    ],
)
def test_refusals(texts, message):
    with pytest.raises(ConfigurationError, match=message):
        compare(*texts)


def test_evaluations_without_a_common_task_are_refused(tmp_path):
    one = evaluation(tmp_path / "one", [1, 0], group="aloha")
    other = evaluation(tmp_path / "other", [1, 0], group="pusht")
    with pytest.raises(ConfigurationError, match=r"no episode of a task in common.*--unpaired"):
        compare(one, other)
    assert compare(one, other, paired=False).contrasts[0].difference == 0


@pytest.mark.parametrize("content", ["{}", "[]", '{"per_task": [{}]}', '{"per_task": []}', "nonsense"])
def test_damaged_evaluations_are_named(tmp_path, content):
    whole, damaged = evaluation(tmp_path / "whole", [1]), evaluation(tmp_path / "damaged", [1])
    (damaged / "eval_info.json").write_text(content)
    with pytest.raises(DatasetError, match=r"damaged.eval_info\.json"):
        compare(whole, damaged)


def test_an_absent_evaluation_is_named(tmp_path):
    with pytest.raises(DatasetError, match=r"no evaluation at .*nowhere"):
        compare(evaluation(tmp_path / "whole", [1]), tmp_path / "nowhere")


def test_names_follow_from_folders():
    assert parse_policy("runs/act") == Recipe("act", ("runs/act/eval_info.json",))
    assert parse_policy("runs/act/eval_info.json").name == "act"
    assert parse_policy("x=a,b").places == ("a/eval_info.json", "b/eval_info.json")
