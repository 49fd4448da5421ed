"""A wrapper around a policy whose chunks are longer than every episode."""

from cases_temporal_ensemble import WRAPPED
from short_runs import said, trained

(CASE,) = WRAPPED


def test_a_wrapper_executes_no_more_either(caplog):
    config = CASE.config()
    policy = trained(config, 4)
    assert config.n_action_steps == 4
    assert policy._action_queue.settings.n_action_steps == 4
    assert any("temporal_ensemble" in line for line in said(caplog))


def test_a_wrapper_keeps_what_was_asked_for(caplog):
    config = CASE.config(n_action_steps=5)
    trained(config, 4)
    assert config.n_action_steps == 5
    assert any("n_action_steps=5 executes steps from 4 on" in line for line in said(caplog))
