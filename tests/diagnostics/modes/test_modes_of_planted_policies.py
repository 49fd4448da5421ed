"""Fake policies through the three gates: what they do is known, and so must the answer be."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from planted_gates import REPLAN, Planted, act, demonstrations, of_shares, one_hot, settings
from rich.console import Console

from lerobot_act_chunking.diagnostics.modes.causes import BLENDED, NONE, SWITCHED, UNDERTRAINED, UNKNOWN
from lerobot_act_chunking.diagnostics.modes.measuring import find_ways, measure
from lerobot_act_chunking.diagnostics.modes.plots import plot_report
from lerobot_act_chunking.diagnostics.modes.terminal import print_report

EPISODES = 100
MODES = of_shares(EPISODES)


@pytest.fixture(scope="module")
def demonstrated():
    return demonstrations(of_shares(100))


def report_of(policy, demonstrated, **asked):
    loaded, rollouts = act(policy, EPISODES)
    return measure(settings(episodes=EPISODES, **asked), loaded, rollouts, demonstrated)


def test_proportions_are_found_exactly_and_pass(demonstrated, tmp_path):
    report = report_of(Planted(lambda number, _: one_hot(MODES[number])), demonstrated)
    assert report.episodes.counts == (80, 15, 5)
    assert report.chunks.frequencies.counts == (80, 15, 5)
    assert (report.verdict, report.judgement.cause.name, report.exit_code) == ("pass", NONE, 0)
    assert report.episodes.divergence == pytest.approx(0, abs=1e-9)
    assert report.episodes.p_value > 0.9
    assert [each and each.rate for each in report.successes] == [1.0, 1.0, 1.0, None]
    content = json.loads(report.write(tmp_path / "modes.json").read_text())
    assert (content["tool"], content["source"], content["told_by"]) == ("modes", "recording", "environment")
    assert plot_report(report, tmp_path / "modes.png").stat().st_size > 10_000
    console = Console(record=True, width=140)
    print_report(report, console)
    assert "3 of 3 ways are taken" in console.export_text()


def test_always_one_gate_fails_and_names_what_is_missing(demonstrated):
    report = report_of(Planted(lambda number, _: one_hot(0)), demonstrated)
    assert report.episodes.missing(settings().thresholds) == [1, 2]
    assert (report.verdict, report.judgement.cause.name) == ("fail", UNDERTRAINED)
    assert "mode 1 and 2" in report.judgement.cause.because
    assert "balance_modes" in report.judgement.cause.fix
    assert report.episodes.p_value < 1e-3


def test_between_two_gates_is_invalid_in_chunks_and_in_episodes(demonstrated):
    report = report_of(Planted(lambda number, _: (0.5, 0.5, 0.0)), demonstrated)
    assert report.episodes.invalid == report.chunks.frequencies.invalid == EPISODES
    assert (report.verdict, report.judgement.cause.name) == ("fail", BLENDED)


def test_right_chunks_that_change_their_way_are_switching(demonstrated):
    def way(number, call):
        return one_hot((MODES[number] + call) % 3)

    report = report_of(Planted(way, replan=REPLAN), demonstrated)
    assert report.chunks.frequencies.good(settings().thresholds)
    assert not report.episodes.good(settings().thresholds)
    assert report.switching.share > 0.9
    assert report.judgement.cause.name == SWITCHED


def test_staying_with_a_way_is_no_switching(demonstrated):
    report = report_of(Planted(lambda number, _: one_hot(MODES[number]), replan=REPLAN), demonstrated)
    assert report.switching.episodes > 90
    assert report.switching.switched == 0


def test_too_few_episodes_are_inconclusive(demonstrated):
    loaded, rollouts = act(Planted(lambda number, _: one_hot(0)), 20)
    report = measure(settings(episodes=20), loaded, rollouts, demonstrated)
    assert (report.verdict, report.exit_code) == ("inconclusive", 10)
    assert "--episodes 100" in report.reasons[0]


def test_without_demonstrations_shares_say_what_to_expect():
    report = report_of(Planted(lambda number, _: one_hot(0)), None, shares=(80, 15, 5))
    assert (report.source, report.chunks, report.verdict) == ("shares", None, "fail")
    assert report.judgement.cause.name == UNKNOWN
    assert "--dataset" in report.judgement.cause.fix


def test_without_either_nothing_is_known():
    report = report_of(Planted(lambda number, _: one_hot(0)), None)
    assert (report.verdict, report.exit_code, report.episodes) == ("inconclusive", 10, None)


def rollout(motion, mode=None):
    return SimpleNamespace(commands=motion, mode=mode, inferences=(), success=True)


def test_where_the_environment_says_nothing_the_motion_tells(demonstrated):
    motions = [each * demonstrated.unit for each in demonstrated.motions]
    ways = find_ways(settings(), [rollout(each) for each in motions], demonstrated)
    assert ways.told_by == "motion"
    np.testing.assert_array_equal(ways.modes, demonstrated.modes)


def test_a_mode_that_nobody_demonstrated_is_counted_with_no_share(demonstrated):
    ways = find_ways(settings(), [rollout(None, mode) for mode in (0, 1, 4)], demonstrated)
    assert ways.proportions == (0.8, 0.15, 0.05, 0.0, 0.0)


def test_clusters_are_not_held_against_what_the_environment_calls_its_ways(demonstrated):
    unnamed = replace(demonstrated, source="clusters")
    report = report_of(Planted(lambda number, _: one_hot(0)), unnamed, shares=(80, 15, 5))
    assert (report.source, report.told_by, report.chunks) == ("shares", "environment", None)
    assert "does not record" in report.notes[0]
