"""What LeRobot 0.7 asks of policies, asked of ours by the LeRobot that is installed."""

import sys

import pytest
import torch
from huggingface_hub import ModelCard
from lerobot.common import train_utils
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.pretrained import PreTrainedPolicy
from policy_cases import CASES, WRAPPED

from lerobot_act_chunking import compat
from lerobot_act_chunking.errors import FeatureError
from lerobot_act_chunking.hub.card import policy_section
from lerobot_act_chunking.policies import model_card
from lerobot_act_chunking.policies.chunked_policy import ChunkedPolicy

ALL = [*CASES, *WRAPPED]
STATE = CASES[0]


def case_id(case):
    return f"{case.type}-{case.name}"


def drop_queued_actions(policy) -> None:
    """As later base classes: what is listed is cleared, of dictionaries only the actions."""
    for name in getattr(policy, "_action_queue_attrs", ("_queues", "_action_queue")):
        queue = getattr(policy, name, None)
        if isinstance(queue, dict):
            queue["action"].clear()
        elif queue is not None:
            queue.clear()


@pytest.mark.parametrize("case", ALL, ids=case_id)
def test_dropped_actions_are_predicted_anew_and_observations_kept(case):
    """As if the chunk had run out: the next action begins a chunk, and sees the same history."""
    policy, due = (case.policy(execution="open_loop", n_action_steps=steps) for steps in (3, 2))
    chunks = {policy: [], due: []}
    for each in chunks:
        each._action_queue.on_chunk = lambda event, each=each: chunks[each].append(event.chunk)
    batches = [{key: value + 0.1 * step for key, value in case.batch().items()} for step in range(3)]
    for step in (0, 1):
        for each in (policy, due):
            each.select_action(batches[step])
    drop_queued_actions(policy)
    torch.testing.assert_close(policy.select_action(batches[2]), due.select_action(batches[2]))
    assert [len(each) for each in chunks.values()] == [2, 2]
    assert policy._action_queue.n_steps == 3


def test_nobody_else_has_to_be_told_where_the_actions_wait():
    listed = getattr(PreTrainedPolicy, "_action_queue_attrs", ("_queues", "_action_queue"))
    assert "_action_queue" in listed
    assert not hasattr(STATE.policy(), "_queues")


@pytest.fixture
def cards_from_training(monkeypatch):
    """A LeRobot whose cards are made by a function of its training, as in all after 0.6.1."""

    def generate_model_card(model_cfg, cfg=None, dataset_meta=None):
        return ModelCard(f"---\nlicense: mit\n---\n# {model_cfg.type}\n")

    monkeypatch.delattr(PreTrainedPolicy, "generate_model_card", raising=False)
    monkeypatch.setattr(train_utils, "generate_model_card", generate_model_card, raising=False)


@pytest.mark.parametrize("case", [STATE, *WRAPPED], ids=case_id)
def test_cards_made_by_training_say_how_our_policies_act_once(cards_from_training, case):
    for _ in range(2):
        model_card.install()
    config = case.config()
    expected = f"# {config.type}\n\n{policy_section(config, command=sys.argv)}"
    assert train_utils.generate_model_card(config, cfg=None, dataset_meta=None).text.endswith(expected)
    assert case.policy().generate_model_card().text.endswith(expected)
    assert train_utils.generate_model_card(config).text.count("acts\n") == 1


def test_cards_of_other_policies_are_left_alone(cards_from_training):
    model_card.install()
    assert str(train_utils.generate_model_card(ACTConfig(device="cpu"))).endswith("# act\n")


def test_a_lerobot_that_makes_cards_elsewhere_is_left_alone(monkeypatch, caplog):
    monkeypatch.delattr(PreTrainedPolicy, "generate_model_card", raising=False)
    monkeypatch.delattr(train_utils, "generate_model_card", raising=False)
    model_card.install()
    (line,) = caplog.messages
    assert line.startswith("model cards do not say how a policy acts: ")


@pytest.mark.parametrize("output", [{"action": 1, "prediction": 2}, {"action": 1}, 1])
def test_actions_are_found_in_whatever_a_policy_returns(output):
    assert compat.action_of(output) == 1


def test_a_mapping_without_actions_is_named():
    with pytest.raises(FeatureError, match="without 'action', with: prediction, mask"):
        compat.action_of({"prediction": 1, "mask": 2})


@pytest.mark.parametrize("case", CASES, ids=case_id)
def test_what_may_be_called_on_spread_weights_exists(case):
    policy = case.policy()
    inherited = getattr(PreTrainedPolicy, "_fsdp_forward_methods", ("select_action", "predict_action_chunk"))
    assert {*inherited, "predict_samples"} == set(type(policy)._fsdp_forward_methods)
    assert all(type(each) is str for each in type(policy)._fsdp_wrap_modules)


def test_every_policy_names_the_units_of_sharded_training():
    for policy_class in ChunkedPolicy.__subclasses__():
        cases = [case for case in CASES if case.type == policy_class.name]
        found = {type(module).__name__ for case in cases for module in case.policy().modules()}
        assert set(policy_class._fsdp_wrap_modules) <= found


def test_saving_writes_what_loading_needs_whatever_else_is_passed(tmp_path):
    """0.6.1 passes ``state_dict`` to ``_save_pretrained``, later ones do not: ours is LeRobot's own."""
    assert ChunkedPolicy._save_pretrained is PreTrainedPolicy._save_pretrained
    policy = STATE.policy()
    policy.save_pretrained(tmp_path)
    loaded = type(policy).from_pretrained(tmp_path)
    assert torch.equal(loaded.predict_action_chunk(STATE.batch()), policy.predict_action_chunk(STATE.batch()))
