"""Interventions: each changes one thing that this policy can change, and all is as before afterwards."""

import pytest
from small_policies import OURS, make_policy, save

from lerobot_act_chunking.diagnostics.core.executable import Executable, changed
from lerobot_act_chunking.diagnostics.diagnose.playing import Stage, Task, changing, later_checkpoint
from lerobot_act_chunking.diagnostics.diagnose.trials import MEANINGS, Trial, make_trials
from lerobot_act_chunking.envs.configuration_envs import AlohaSimEnvConfig

ENVIRONMENT = AlohaSimEnvConfig(task="transfer_cube", obs_type="state", episode_length=3)
EXECUTIONS = [
    {"execution": "open_loop"},
    {"execution": "open_loop", "n_action_steps": 2},
    {"execution": "receding", "replan_interval": 4},
    {"execution": "receding", "replan_interval": 1},
    {"execution": "crossfade", "replan_interval": 2, "latency_steps": 2},
    {"execution": "ensemble", "replan_interval": 1},
    {"execution": "adaptive", "replan_interval": 2, "smoothing_steps": 3},
]


def executable(**settings):
    policy = make_policy(**settings)
    return policy, Executable("somewhere", policy.policy.config, wrapped=False)


def hypotheses(**settings):
    return {each.hypothesis for each in make_trials(executable(**settings)[1], smoothing=3)}


@pytest.mark.parametrize("settings", EXECUTIONS)
def test_each_changes_something_that_works(settings):
    policy, subject = executable(**settings)
    before = policy.policy.config.execution_settings
    trials = make_trials(subject, smoothing=3)
    assert trials
    assert len({each.key for each in trials}) == len(trials)
    for each in trials:
        assert each.hypothesis in MEANINGS
        assert each.repair.startswith("--policy.")
        assert changed(subject.config, dict(each.values)).execution_settings != before
        with changing(policy, each) as acting:
            acting.policy.reset()
            assert acting.policy.config.execution_settings != before
        assert policy.policy.config.execution_settings == before


def test_what_is_tried_follows_from_how_chunks_are_executed():
    open_loop = hypotheses(execution="open_loop")
    assert open_loop == {"chunk too long", "chunk boundary", "jitter"}
    assert "chunk too short" in hypotheses(execution="open_loop", n_action_steps=2)
    assert "over-smoothing" in hypotheses(execution="ensemble", replan_interval=1)
    assert "over-smoothing" not in hypotheses(execution="receding", replan_interval=1)
    assert "chunk too long" not in hypotheses(execution="receding", replan_interval=1)
    assert "chunk boundary" in hypotheses(execution="receding", replan_interval=4)
    assert "latency" in hypotheses(execution="crossfade", replan_interval=2, latency_steps=2)
    assert "jitter" not in hypotheses(execution="receding", replan_interval=2, smoothing_steps=3)


def test_averaging_alone_is_taken_from_an_ensemble():
    _, subject = executable(execution="ensemble", replan_interval=2)
    newest, recent = [each for each in make_trials(subject) if each.hypothesis == "over-smoothing"]
    settings = changed(subject.config, dict(newest.values)).execution_settings
    assert (settings.execution, settings.replan_interval, settings.n_action_steps) == ("receding", 2, 8)
    assert newest.size == 1
    settings = changed(subject.config, dict(recent.values)).execution_settings
    assert (settings.execution, settings.replan_interval, settings.weight_growth) == ("ensemble", 2, -0.1)


def test_an_ensemble_that_forgets_soon_is_not_told_to():
    _, subject = executable(execution="ensemble", ensemble_weighting="recency", temporal_ensemble_coeff=0.5)
    assert [each.change for each in make_trials(subject) if each.hypothesis == "over-smoothing"] == [
        "the newest chunk alone"
    ]


def test_draws_are_changed_where_there_are_any():
    assert "wrong mode" not in hypotheses()
    drawn = hypotheses(use_vae=True, z_inference="sample", z_hold="chunk", n_vae_encoder_layers=1)
    assert "wrong mode" in drawn


def test_lerobots_policies_are_told_a_command():
    config = make_policy(OURS).policy.config
    subject = Executable("place", config, wrapped=True)
    assert all(each.repair.startswith("act-chunking wrap place --out") for each in make_trials(subject))


def test_weights_statistics_and_draws_are_put_back(monkeypatch):
    policy, _ = executable(use_ema=True)
    average = policy.policy.ema
    with changing(policy, Trial("averaged weights", "raw", raw_weights=True)):
        assert policy.policy.ema is None
    assert policy.policy.ema is average


def test_another_draw_is_other_noise(tmp_path):
    policy = make_policy(action_likelihood="gaussian", action_temperature=1.0)
    stage = Stage(Executable(save(policy, tmp_path), policy.policy.config, wrapped=False), ENVIRONMENT)
    with stage.open() as play:
        one, again, other = (play(Task(Trial("draw", "noise", draw=draw), (1000,)))[0] for draw in (0, 0, 1))
    assert (one.commands == again.commands).all()
    assert (one.commands != other.commands).any()


def test_a_later_checkpoint_of_the_same_training(tmp_path):
    for step in ("000100", "000200"):
        (tmp_path / "checkpoints" / step / "pretrained_model").mkdir(parents=True)
    first, last = (tmp_path / "checkpoints" / step / "pretrained_model" for step in ("000100", "000200"))
    assert later_checkpoint(str(first)) == last
    assert later_checkpoint(str(last)) is None
    assert later_checkpoint(str(tmp_path)) is None
