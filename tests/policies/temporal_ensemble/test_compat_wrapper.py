"""What LeRobot 0.7 asks of policies, asked of the wrapper by the LeRobot that is installed."""

import torch
from cases_temporal_ensemble import WRAPPED

(CASE,) = WRAPPED


def in_a_mapping(method):
    return lambda *args, **kwargs: {"action": method(*args, **kwargs), "prediction": None}


def test_the_wrapper_takes_actions_out_of_mappings():
    policy, plain, batch = CASE.policy(), CASE.policy(), CASE.batch()
    policy.inner.predict_action_chunk = in_a_mapping(policy.inner.predict_action_chunk)
    assert torch.equal(policy.predict_action_chunk(batch), plain.predict_action_chunk(batch))
    assert torch.equal(policy.select_action(batch), plain.select_action(batch))


def test_the_wrapper_answers_questions_if_its_inner_policy_does():
    policy = CASE.policy()
    assert not policy.supports_text_generation()
    policy.inner.supports_text_generation = lambda: True
    policy.inner.generate_text = lambda batch: f"{len(batch)} keys"
    assert policy.supports_text_generation()
    assert policy.generate_text(CASE.batch()) == "5 keys"
