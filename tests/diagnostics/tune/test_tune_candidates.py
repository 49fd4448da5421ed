"""Which executions are tried, of which policies."""

from types import SimpleNamespace

import pytest
from small_policies import make_policy, save

from lerobot_act_chunking.diagnostics.core.executable import executable_digest, execute, smoothing_to_try
from lerobot_act_chunking.diagnostics.tune.subject import read_subject
from lerobot_act_chunking.diagnostics.tune.writing import wrap_command


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    policy = make_policy(latency_steps=1, execution="crossfade", n_action_steps=6, replan_interval=3)
    return save(policy, tmp_path_factory.mktemp("own"))


@pytest.fixture(scope="module")
def theirs(tmp_path_factory):
    return save(make_policy("act", n_action_steps=5, dropout=0.0), tmp_path_factory.mktemp("theirs"))


def test_the_present_settings_come_first_and_none_twice(own):
    subject = read_subject(own)
    assert str(subject.present) == "crossfade R=3 n=6"
    assert not subject.wrapped
    settings = [each.settings for each in subject.candidates]
    assert len({*settings}) == len(settings) > 8
    assert {each.execution for each in settings} == {
        "crossfade",
        "receding",
        "ensemble",
    }  # late: no open_loop
    assert {each.latency_steps for each in settings} == {1}
    assert len({each.key for each in subject.candidates}) == len(settings)


@pytest.mark.parametrize(
    ("stride", "fps", "steps"), [(1, 50, 5), (1, 30, 3), (1, 200, 19), (1, 10, 1), (1, None, 5), (5, 50, 1)]
)
def test_chunks_are_smoothed_over_a_tenth_of_a_second_where_every_step_is_predicted(stride, fps, steps):
    assert smoothing_to_try(SimpleNamespace(chunk_stride=stride), fps) == steps
    wrapper = SimpleNamespace(inner_config=SimpleNamespace(chunk_stride=stride))
    assert smoothing_to_try(wrapper, fps) == steps


def test_smoothed_and_unsmoothed_chunks_are_tried(own, theirs):
    for checkpoint in (own, theirs):
        candidates = read_subject(checkpoint).candidates
        assert {each.settings.smoothing_steps for each in candidates} == {1, 5}
        assert any(str(each).startswith("crossfade R=2 n=8 smooth=5") for each in candidates)


def test_a_policy_that_smooths_is_also_tried_without(tmp_path):
    path = save(make_policy(execution="crossfade", smoothing_steps=3), tmp_path)
    present, *others = read_subject(path).candidates
    assert present.settings.smoothing_steps == 3
    assert 1 in {each.settings.smoothing_steps for each in others}


def test_a_policy_acts_as_a_candidate(own):
    subject = read_subject(own)
    policy = subject.load()
    for candidate in subject.candidates:
        execute(policy, candidate.values)
        policy.policy.reset()
        assert policy.policy.config.execution_settings == candidate.settings


def test_lerobots_policies_are_tried_in_the_wrapper(theirs):
    subject = read_subject(theirs)
    assert subject.wrapped
    assert str(subject.present) == "open_loop n=5"
    policy, candidate = subject.load(), subject.candidates[-1]
    execute(policy, candidate.values)
    policy.policy.reset()
    assert policy.policy.config.execution_settings == candidate.settings
    assert candidate.settings.chunk_size == 8


def test_what_lerobots_act_averages_is_said_in_the_wrappers_words(tmp_path):
    path = save(make_policy("act", n_action_steps=1, temporal_ensemble_coeff=-0.1, dropout=0.0), tmp_path)
    subject = read_subject(path)
    assert str(subject.present) == "ensemble recency R=1 n=8"
    assert subject.present.settings.temporal_ensemble_coeff == 0.1
    command = wrap_command(subject, subject.present)
    assert command.startswith(f"act-chunking wrap {path} --out <folder> --execution ensemble")
    assert "--replan-interval 1 --weighting recency --coeff 0.1" in command


def test_calls_per_second_count_what_a_chunk_costs(own):
    present = read_subject(own).present
    assert present.calls_per_second(30) == 10


def test_a_checkpoint_is_known_by_all_but_its_execution(own, theirs, tmp_path):
    other = save(make_policy(latency_steps=1, execution="receding", replan_interval=2), tmp_path / "other")
    late = save(make_policy(latency_steps=2, execution="receding", replan_interval=2), tmp_path / "late")
    assert executable_digest(read_subject(own)) == executable_digest(read_subject(other))
    assert len({executable_digest(read_subject(each)) for each in (own, theirs, late)}) == 3
