import math
import re

import pytest

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.errors import ConfigurationError


def settings(execution="open_loop", chunk_size=10, **fields):
    return ExecutionSettings(chunk_size, execution, **fields)


@pytest.mark.parametrize(
    ("execution", "fields", "expected"),
    [
        ("open_loop", {}, {"n_action_steps": 10, "replan_interval": 10, "gripper_dims": ()}),
        ("open_loop", {"n_action_steps": 4}, {"n_action_steps": 4, "replan_interval": 4}),
        ("receding", {"n_action_steps": 2}, {"n_action_steps": 2, "replan_interval": 1}),
        ("receding", {"latency_steps": 9}, {"replan_interval": 1}),
        (
            "ensemble",
            {},
            {"temporal_ensemble_coeff": 0.01, "ensemble_weighting": "act"},
        ),
        ("ensemble", {"latency_steps": 8}, {"replan_interval": 1}),
        ("ensemble", {"ensemble_weighting": "uniform"}, {"temporal_ensemble_coeff": 0.0}),
        ("ensemble", {"temporal_ensemble_coeff": 0.0}, {"temporal_ensemble_coeff": 0.0}),
        ("crossfade", {"replan_interval": 5}, {"crossfade_steps": 5}),
        ("crossfade", {"chunk_size": 100}, {"replan_interval": 25, "crossfade_steps": 50}),
        ("crossfade", {"replan_interval": 6, "latency_steps": 1}, {"crossfade_steps": 3}),
        ("crossfade", {"latency_steps": 8}, {"replan_interval": 1, "crossfade_steps": 1}),
        ("adaptive", {}, {"adaptive_kernel": "gate", "adaptive_scale": 3.0, "temporal_ensemble_coeff": 0.01}),
        ("adaptive", {"adaptive_kernel": "cosine"}, {"adaptive_scale": 5.0}),
        ("adaptive", {"adaptive_kernel": "gaussian"}, {"adaptive_scale": 1.5}),
        ("coherence", {}, {"n_samples": 8, "smoothing_steps": 1}),
        ("receding", {}, {"temporal_ensemble_coeff": None, "crossfade_steps": None, "n_samples": None}),
    ],
)
def test_defaults(execution, fields, expected):
    chosen = settings(execution, **fields)
    assert {name: getattr(chosen, name) for name in expected} == expected


@pytest.mark.parametrize("execution", ["receding", "ensemble", "crossfade", "adaptive", "coherence"])
@pytest.mark.parametrize("chunk_size", [3, 10, 100])
@pytest.mark.parametrize("latency", [0, 1])
def test_by_default_replanning_leaves_an_overlap(execution, chunk_size, latency):
    chosen = settings(execution, chunk_size, latency_steps=latency)
    assert 1 <= chosen.replan_interval < chunk_size - latency


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"execution": "queue"}, "unknown execution 'queue'; choose one of: open_loop, receding, ensemble,"),
        (
            {"execution": "ensemble", "ensemble_weighting": "old"},
            "unknown ensemble_weighting 'old'; choose one of: act, recency, uniform",
        ),
        (
            {"execution": "adaptive", "adaptive_kernel": "cos"},
            "unknown adaptive_kernel 'cos'; choose one of: cosine, gaussian, gate",
        ),
        (
            {"temporal_ensemble_coeff": 0.01},
            "temporal_ensemble_coeff=0.01 has no effect with execution=open_loop: set execution=ensemble or "
            "execution=adaptive, or temporal_ensemble_coeff=null",
        ),
        ({"execution": "receding", "ensemble_weighting": "act"}, "ensemble_weighting=act has no effect with"),
        ({"execution": "ensemble", "crossfade_steps": 2}, "set execution=crossfade, or crossfade_steps=null"),
        ({"execution": "ensemble", "adaptive_kernel": "gate"}, "adaptive_kernel=gate has no effect with"),
        ({"execution": "ensemble", "adaptive_scale": 1.0}, "adaptive_scale=1.0 has no effect with"),
        ({"execution": "ensemble", "n_samples": 3}, "n_samples=3 has no effect with execution=ensemble"),
        (
            {"execution": "ensemble", "temporal_ensemble_coeff": -0.1},
            "temporal_ensemble_coeff=-0.1 must be at least 0; to favour new predictions, for which LeRobot "
            "takes a negative one: set ensemble_weighting=recency and temporal_ensemble_coeff=0.1",
        ),
        (
            {"execution": "ensemble", "temporal_ensemble_coeff": math.nan},
            "temporal_ensemble_coeff=nan must be",
        ),
        (
            {"execution": "ensemble", "temporal_ensemble_coeff": math.inf},
            "temporal_ensemble_coeff=inf must be",
        ),
        (
            {"execution": "ensemble", "temporal_ensemble_coeff": 0.1, "ensemble_weighting": "uniform"},
            "temporal_ensemble_coeff=0.1 has no effect with ensemble_weighting=uniform: set "
            "temporal_ensemble_coeff=0, or ensemble_weighting=act",
        ),
        ({"chunk_size": 0}, "chunk_size=0 must be at least 1"),
        ({"n_action_steps": 0}, "n_action_steps=0 must be at least 1"),
        ({"execution": "receding", "replan_interval": 0}, "replan_interval=0 must be at least 1"),
        ({"execution": "receding", "latency_steps": -1}, "latency_steps=-1 must be at least 0"),
        ({"n_action_steps": 11}, "n_action_steps=11 exceeds the 10 control steps of a chunk: only predicted"),
        (
            {"execution": "ensemble", "n_action_steps": 4, "replan_interval": 4},
            "execution=ensemble needs overlapping chunks: replan_interval=4 must be below n_action_steps=4: "
            "set replan_interval=null",
        ),
        ({"execution": "receding", "n_action_steps": 1}, "replan_interval=1 must be below n_action_steps=1"),
        (
            {"execution": "receding", "replan_interval": 6, "latency_steps": 5},
            "replan_interval=6 + latency_steps=5 exceeds n_action_steps=10: the old chunk would end before "
            "the new one can be used",
        ),
        (
            {"execution": "ensemble", "replan_interval": 6, "latency_steps": 4},
            "execution=ensemble has nothing to blend: replan_interval=6 + latency_steps=4 must be below "
            "n_action_steps=10, so that two chunks overlap",
        ),
        (
            {"replan_interval": 5},
            "execution=open_loop runs each chunk to its end: replan_interval=5 must equal n_action_steps=10: "
            "set replan_interval=null, or execution=receding to replan earlier",
        ),
        (
            {"latency_steps": 1},
            "execution=open_loop leaves nothing to execute during latency_steps=1: set execution=receding or",
        ),
        (
            {"execution": "crossfade", "replan_interval": 6, "latency_steps": 1, "crossfade_steps": 4},
            "crossfade_steps=4 must be between 1 and the overlap of two chunks, n_action_steps - "
            "replan_interval - latency_steps = 3",
        ),
        (
            {"execution": "crossfade", "crossfade_steps": 0},
            "crossfade_steps=0 must be between 1 and the overlap",
        ),
        ({"execution": "adaptive", "adaptive_scale": 0.0}, "adaptive_scale=0.0 must be a positive number"),
        (
            {"execution": "adaptive", "adaptive_scale": math.nan},
            "adaptive_scale=nan must be a positive number",
        ),
        ({"execution": "coherence", "n_samples": 1}, "n_samples=1 leaves nothing to choose from: at least 2"),
        (
            {"smoothing_steps": 4},
            "smoothing_steps=4 must be odd: a mean over an even number of steps would shift the motion by "
            "half a step: set smoothing_steps=3 or smoothing_steps=5",
        ),
        ({"smoothing_steps": 0}, "smoothing_steps=0 must be at least 1"),
        ({"smoothing_steps": 11}, "smoothing_steps=11 exceeds the 10 control steps of a chunk"),
        ({"gripper_dims": (-1, 2)}, "gripper_dims=[-1, 2] must be distinct indices from 0 on"),
        ({"gripper_dims": (2, 2)}, "gripper_dims=[2, 2] must be distinct indices from 0 on"),
    ],
)
def test_nonsense_is_refused_with_the_reason(fields, message, unchecked):
    with pytest.raises(ConfigurationError, match=re.escape(message)):
        settings(**fields)


@pytest.mark.parametrize("execution", ["receding", "coherence"])
def test_a_new_chunk_may_begin_where_the_old_one_ends(execution):
    assert settings(execution, replan_interval=6, latency_steps=4).overlapping_chunks == 1


@pytest.mark.parametrize(
    ("weighting", "coeff", "growth"),
    [
        ("act", 0.1, 0.1),
        ("recency", 0.1, -0.1),
        ("uniform", 0.0, 0.0),
        ("uniform", None, 0.0),
        (None, None, 0.01),
    ],
)
def test_weight_growth_is_positive_where_old_predictions_weigh_more(weighting, coeff, growth):
    chosen = settings("ensemble", ensemble_weighting=weighting, temporal_ensemble_coeff=coeff)
    assert chosen.weight_growth == growth


@pytest.mark.parametrize(
    ("used", "interval", "latency"),
    [(2, 1, 0), (5, 1, 0), (5, 2, 0), (5, 3, 1), (5, 1, 3), (10, 4, 1), (10, 3, 3)],
)
def test_the_most_chunks_that_cover_a_step(used, interval, latency):
    chosen = settings("ensemble", n_action_steps=used, replan_interval=interval, latency_steps=latency)
    covering = [
        sum(latency <= step - start < used for start in range(0, 60, interval)) for step in range(20, 40)
    ]
    assert chosen.overlapping_chunks == max(covering)
