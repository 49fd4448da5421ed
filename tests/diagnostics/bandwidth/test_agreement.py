"""The closed form against the real executor."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.diagnostics.bandwidth import agreement as module
from lerobot_act_chunking.diagnostics.bandwidth.agreement import check_agreement, execute
from lerobot_act_chunking.diagnostics.bandwidth.closed_form import filter_for
from lerobot_act_chunking.diagnostics.bandwidth.filter import ensemble_filter, newest_chunk_filter
from lerobot_act_chunking.diagnostics.bandwidth.terminal import describe


def ensemble(chunk_size, interval, weighting="act", coeff=0.01, latency=0, used=None):
    return ExecutionSettings(
        chunk_size,
        "ensemble",
        used or chunk_size,
        interval,
        latency,
        ensemble_weighting=weighting,
        temporal_ensemble_coeff=float(coeff),
    )


@pytest.mark.parametrize(
    "settings",
    [
        ensemble(100, 1),
        ensemble(100, 1, "recency", 0.1),
        ensemble(100, 50),
        ensemble(40, 7, "uniform", 0.0, latency=3),
        ensemble(40, 7, "act", 10.0, latency=3, used=31),
        ensemble(1000, 90, "recency", 0.003),
        ExecutionSettings(1),
        ExecutionSettings(20, n_action_steps=13),
        ExecutionSettings(20, "receding", replan_interval=6, latency_steps=2),
        ExecutionSettings(30, "crossfade", replan_interval=6, latency_steps=2, crossfade_steps=9),
        ExecutionSettings(30, "crossfade", replan_interval=6, crossfade_steps=9, smoothing_steps=5),
    ],
    ids=describe,
)
def test_the_executor_is_the_filter(settings):
    agreement = check_agreement(settings, filter_for(settings))
    assert agreement.step_error <= 1e-6
    assert agreement.plan_error <= 1e-6
    assert agreement.noise_error <= 0.05
    assert agreement.agrees


timing = st.tuples(st.integers(1, 8), st.integers(0, 4), st.integers(1, 12))


@given(timing, st.sampled_from(["act", "recency", "uniform"]), st.floats(0, 2))
@hypothesis_settings(max_examples=25, deadline=None)
def test_every_ensemble_is_its_filter(steps, weighting, coeff):
    interval, latency, overlap = steps
    settings = ensemble(
        interval + latency + overlap, interval, weighting, weighting != "uniform" and coeff, latency
    )
    assert check_agreement(settings, filter_for(settings)).agrees


@pytest.mark.parametrize(
    ("settings", "wrong"),
    [
        (ensemble(20, 1, "act", 0.1), ensemble_filter(20, 1, "recency", 0.1, 0)),
        (ensemble(20, 1, "act", 0.1), ensemble_filter(20, 1, "act", 0.12, 0)),
        (ensemble(20, 4), ensemble_filter(20, 4, "act", 0.01, 1)),
        (ensemble(20, 4, used=19), ensemble_filter(20, 4, "act", 0.01, 0)),
        (ExecutionSettings(20, "receding", replan_interval=6), newest_chunk_filter(6, 1)),
    ],
)
def test_another_filter_does_not_agree(settings, wrong):
    agreement = check_agreement(settings, wrong)
    assert agreement.step_error > 1e-3
    assert not agreement.agrees


def test_noise_sees_the_weighting_that_the_gain_cannot():
    settings = ensemble(20, 1, "act", 0.1)
    frequency, response = module.measure_response(settings, np.random.default_rng(0))
    mirrored = ensemble_filter(20, 1, "recency", 0.1, 0).response(frequency)
    np.testing.assert_allclose(np.abs(response), np.abs(mirrored), atol=1e-9)
    assert np.abs(response - mirrored).max() > 0.3


def test_only_innovations_are_filtered():
    executed = execute(ensemble(30, 4), lambda step: np.zeros(2), 80)
    np.testing.assert_allclose(executed, 0, atol=1e-12)
    assert executed.shape == (80, 2)


def test_a_delayed_plan_would_be_noticed(monkeypatch):
    class Late(module.ChunkExecutor):
        def step(self, predict, batch_size):
            return super().step(lambda envs: predict(envs).roll(1, dims=1), batch_size)

    monkeypatch.setattr(module, "ChunkExecutor", Late)
    settings = ensemble(20, 1)
    agreement = check_agreement(settings, filter_for(settings))
    assert agreement.plan_error > 0.1
    assert not agreement.agrees


def test_grippers_are_left_out():
    settings = ExecutionSettings(20, "ensemble", replan_interval=1, gripper_dims=(0, 6))
    assert check_agreement(settings, filter_for(settings)).agrees
