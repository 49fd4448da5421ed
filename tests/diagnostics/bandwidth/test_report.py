"""The report, its verdict and its JSON."""

import dataclasses
import json

import numpy as np
import pytest
from rich.console import Console

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.diagnostics.bandwidth import measuring
from lerobot_act_chunking.diagnostics.bandwidth.advice import recommend
from lerobot_act_chunking.diagnostics.bandwidth.closed_form import closed_form
from lerobot_act_chunking.diagnostics.bandwidth.measuring import measure
from lerobot_act_chunking.diagnostics.bandwidth.plots import plot_report
from lerobot_act_chunking.diagnostics.bandwidth.settings import Limits
from lerobot_act_chunking.diagnostics.bandwidth.source import Source, read_source
from lerobot_act_chunking.diagnostics.bandwidth.terminal import describe, print_report
from lerobot_act_chunking.errors import ConfigurationError

PNG = b"\x89PNG\r\n\x1a\n"
ACT = {"chunk_size": 20, "ensemble_weighting": "act", "temporal_ensemble_coeff": 0.1}
RARE = {"chunk_size": 20, "replan_interval": 6, "latency_steps": 1}


def report_of(overrides, fps=50.0, **limits):
    return measure(read_source(None, overrides), fps, Limits(**limits))


def card_of(report):
    console = Console(width=160)
    with console.capture() as capture:
        print_report(report, console)
    return capture.get()


def test_json_holds_the_figures_under_their_names():
    content = json.loads(json.dumps(report_of(ACT).to_json(), allow_nan=False))
    assert content["tool"] == "bandwidth"
    assert content["bandwidth_hz"] == pytest.approx(1.247, abs=1e-3)
    assert content["nyquist_hz"] == 25
    assert content["group_delay_steps"] == pytest.approx(12.62, abs=5e-3)
    assert [content[f"settle_{n}_steps"] for n in (63, 90, 100)] == [16, 19, 19]
    assert content["effective_samples"] == pytest.approx(15.2, abs=0.05)
    assert len(content["impulse_response"]) == 20
    assert sum(content["impulse_response"]) == pytest.approx(1)
    assert content["settings"]["ensemble_weighting"] == "act"
    assert content["measured"]["agrees"] is True
    assert content["measured"]["step_error"] <= 1e-6
    assert content["verdict"] == "pass"
    assert content["thresholds"] == {"max_step_error": 1e-6, "max_noise_error": 0.05}
    assert {point["size"] for point in content["sweep"]} >= {1, 20, 40}
    assert content["checkpoint"] is content["push"] is content["advice"] is None


def test_rare_replanning_reports_its_phases():
    content = report_of(RARE).to_json()
    best, mean, worst = (content["phases"][name] for name in ("best", "mean", "worst"))
    assert [phase["dead_time_steps"] for phase in (best, mean, worst)] == [1, 3.5, 6]
    for name, value in best.items():
        assert worst[name] - value == 5
        assert mean[name] - value == 2.5
    assert worst["settle_100_steps"] == content["settle_100_steps"] == 19
    phases = content["phase_impulse_responses"]
    assert [phase["phase"] for phase in phases] == list(range(6))
    assert phases[0]["ages"] == [6, 12, 18]
    assert phases[1]["ages"] == [1, 7, 13, 19]
    assert all(sum(phase["weights"]) == pytest.approx(1) for phase in phases)
    rebuilt = np.zeros(20)
    for phase in phases:
        rebuilt[phase["ages"]] = np.array(phase["weights"]) / 6
    np.testing.assert_allclose(rebuilt, content["impulse_response"])


def test_early_events_are_answered_sooner():
    start_up = report_of({"chunk_size": 100}).to_json()["start_up"]
    assert [row["event_step"] for row in start_up] == [1, 10, 25, 50, 100]
    assert start_up[0] == {"event_step": 1, "settle_63_steps": 1, "settle_90_steps": 9}
    assert start_up[-1]["settle_90_steps"] == 93


def test_single_actions_have_no_limit_and_valid_json():
    report = report_of({"chunk_size": 1})
    content = json.loads(json.dumps(report.to_json(), allow_nan=False))
    assert content["bandwidth_hz"] is None
    assert content["nyquist_hz"] == 25
    assert content["settle_100_steps"] == content["group_delay_steps"] == 0
    assert "no limit up to 25 Hz" in card_of(report)


@pytest.mark.parametrize("mode", ["adaptive", "coherence"])
def test_modes_without_a_formula_say_so(mode):
    report = report_of({"chunk_size": 12, "execution": mode, "replan_interval": 3})
    content = json.loads(json.dumps(report.to_json(), allow_nan=False))
    assert content["bandwidth_hz"] is content["impulse_response"] is content["measured"] is None
    assert len(content["measured_steps"]) == 3
    assert "there is no transfer function" in card_of(report)


@pytest.mark.parametrize(
    ("limits", "verdict", "code", "reason"),
    [
        ({}, "pass", 0, "no limit was given"),
        ({"disturbance_hz": 0.05, "max_settle_s": 2.0, "loop_gain": 0.01}, "pass", 0, "every limit is met"),
        ({"disturbance_hz": 0.076}, "warn", 0, "at 0.076 Hz the command follows so late that 5"),
        (
            {"disturbance_hz": 0.5},
            "fail",
            11,
            "need a bandwidth of 1.5 Hz (3 times as much), but it is 0.228 Hz",
        ),
        ({"max_settle_s": 1.85}, "fail", 11, "takes up to 1.86 s; allowed are 1.85 s"),
        ({"loop_gain": 0.018}, "fail", 11, "more than half the limit 0.0355"),
    ],
)
def test_verdict_of_acts_default(limits, verdict, code, reason):
    report = report_of({}, **limits)
    assert (report.verdict, report.exit_code) == (verdict, code)
    assert reason in report.reasons[0]


def test_the_worst_phase_is_judged():
    settings = {"execution": "open_loop", "chunk_size": 20}
    assert report_of(settings, max_settle_s=0.37).verdict == "fail"  # 19 steps
    assert report_of(settings, max_settle_s=0.38).verdict == "pass"


@pytest.mark.parametrize(
    ("limits", "verdict", "code"),
    [
        ({"max_settle_s": 0.02}, "fail", 11),
        ({"max_settle_s": 9.0}, "pass", 0),
        ({"loop_gain": 0.1}, "inconclusive", 10),
    ],
)
def test_verdict_without_a_formula(limits, verdict, code):
    report = report_of({"chunk_size": 12, "execution": "adaptive", "replan_interval": 3}, **limits)
    assert (report.verdict, report.exit_code) == (verdict, code)


def test_an_executor_that_differs_from_the_formula_fails(monkeypatch):
    def disagree(settings, kernel):
        return dataclasses.replace(agree(settings, kernel), step_error=0.1)

    agree = measuring.check_agreement
    monkeypatch.setattr(measuring, "check_agreement", disagree)
    report = report_of(ACT)
    assert report.verdict == "fail"
    assert "the executor does not do what the formula says: step error 1.0e-01" in report.reasons[0]


def test_the_disturbance_itself():
    at = report_of({"ensemble_weighting": "uniform"}, disturbance_hz=0.25).at_disturbance
    assert at.gain == pytest.approx(2 / np.pi, abs=1e-3)  # the moving average over half a period
    assert at.phase_deg == pytest.approx(-180 * 0.25 * 99 / 50)
    assert at.missed == pytest.approx(abs(1 - at.gain * np.exp(1j * np.radians(at.phase_deg))))


@pytest.mark.parametrize(
    "limits",
    [
        {"disturbance_hz": 0.4},
        {"max_settle_s": 0.5},
        {"loop_gain": 0.2},
        {"disturbance_hz": 1, "max_settle_s": 0.3},
    ],
)
@pytest.mark.parametrize(("interval", "latency"), [(1, 0), (10, 0), (4, 3)])
def test_recommendations_meet_the_limits_and_are_no_longer_than_needed(limits, interval, latency):
    settings = ExecutionSettings(
        80, "ensemble", replan_interval=interval, ensemble_weighting="act", latency_steps=latency
    )
    limits = Limits(**limits)
    advice = recommend(settings, limits, 50.0)
    assert advice.recommended in advice.candidates
    for candidate in advice.candidates:
        recommended = ExecutionSettings(
            80,
            candidate.execution,
            candidate.n_action_steps,
            candidate.replan_interval,
            latency,
            candidate.temporal_ensemble_coeff,
            candidate.ensemble_weighting,
        )
        report = measure(Source(recommended), 50.0, limits)
        assert report.verdict == "pass"
        assert report.figures.effective_samples == pytest.approx(candidate.effective_samples)
        assert f"--policy.replan_interval={candidate.replan_interval}" in candidate.flags


def test_recommendation_costs_no_more_inferences_if_possible():
    settings = ExecutionSettings(80, "ensemble", replan_interval=10)
    assert recommend(settings, Limits(max_settle_s=1.0), 50.0).recommended.replan_interval == 10
    assert recommend(settings, Limits(max_settle_s=0.1), 50.0).recommended.replan_interval == 5


def test_a_moving_average_of_the_allowed_length_is_hard_to_beat():
    advice = recommend(ExecutionSettings(100, "ensemble", replan_interval=1), Limits(disturbance_hz=1), 50.0)
    assert advice.recommended.n_action_steps == pytest.approx(0.443 * 50 / 3, abs=1)


def test_latency_that_nothing_can_mend():
    settings = ExecutionSettings(80, "ensemble", replan_interval=1, latency_steps=30)
    report = measure(Source(settings), 50.0, Limits(max_settle_s=0.5))
    assert report.advice.recommended is None
    assert report.advice.candidates == []
    assert "make inference faster" in card_of(report)


@pytest.mark.parametrize("name", ["disturbance_hz", "max_settle_s", "loop_gain"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_limits_are_positive(name, value):
    with pytest.raises(ConfigurationError, match=f"{name}={value} must be a positive number"):
        Limits(**{name: value})


@pytest.mark.parametrize("fps", [0.0, -50.0])
def test_fps_is_positive(fps):
    with pytest.raises(ConfigurationError, match=f"fps={fps} must be a positive number"):
        report_of({}, fps=fps)


def test_card_of_acts_default():
    card = card_of(report_of({}))
    for text in (
        "0.228 Hz",
        "57.7 steps (1.15 s)",
        "73 / 93 / 99 steps",
        "0.0355 per step",
        "plan, passes with gain 1",
    ):
        assert text in card


def test_card_with_phases_and_advice():
    card = card_of(report_of(RARE, max_settle_s=0.2))
    for text in ("best phase", "worst phase", "recommended", "--policy.execution=ensemble", "fail"):
        assert text in card


def test_what_smoothing_does_to_the_plan_is_said():
    settings = ExecutionSettings(20, "receding", replan_interval=5, smoothing_steps=5)
    report = measure(Source(settings), 50.0, Limits())
    assert report.agreement.agrees
    assert describe(settings) == "receding, K=20, R=5, mean over 5"
    # |sin(5 w / 2) / (5 sin(w / 2))| = 2 ** -0.5 at w = 2 pi * 4.55 / 50
    assert "half of its power is gone at 4.5 Hz" in card_of(report).replace("\n", " ")


def test_grippers_are_mentioned():
    settings = ExecutionSettings(20, "ensemble", replan_interval=1, gripper_dims=(6, 13))
    assert "Dimensions [6, 13] (grippers)" in card_of(measure(Source(settings), 50.0, Limits()))


@pytest.mark.parametrize(
    ("overrides", "limits"),
    [
        (RARE, {"disturbance_hz": 0.3, "max_settle_s": 0.2}),
        ({"chunk_size": 1}, {}),
        ({"chunk_size": 12, "execution": "adaptive", "replan_interval": 3}, {}),
    ],
)
def test_picture(overrides, limits, tmp_path):
    path = plot_report(report_of(overrides, **limits), tmp_path / "new" / "bandwidth.png")
    assert path.read_bytes().startswith(PNG)


def test_seconds_follow_the_frame_rate():
    slow, fast = (
        closed_form(ExecutionSettings(20, "ensemble", replan_interval=1), fps) for fps in (10.0, 50.0)
    )
    assert fast.bandwidth_hz == pytest.approx(5 * slow.bandwidth_hz)
    assert fast.settle_90_steps == slow.settle_90_steps
