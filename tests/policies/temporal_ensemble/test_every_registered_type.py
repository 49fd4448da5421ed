"""LeRobot's contract of policies, of the wrapper over every type that is registered with it."""

import inspect

import pytest
import torch
from lerobot.policies.factory import get_policy_class, make_policy_config, make_pre_post_processors
from policy_cases import TYPES as OURS
from registered_types import (
    IN_THE_GATE,
    SMALL,
    UNWRAPPABLE,
    make_wrapper,
    observation,
    registered_types,
    training_batch,
    wrapped_config,
)
from tiers import full_tier
from wrapped_cases import A, B

from lerobot_act_chunking.errors import ConfigurationError

DRAWS_EACH_EPISODE_ANEW = ("diffusion_chunked", "vqbet_chunked")
TYPES = [
    pytest.param(name, marks=() if name in IN_THE_GATE else full_tier)
    for name in registered_types()
    if name not in UNWRAPPABLE
]


@pytest.fixture(params=TYPES)
def policy_type(request):
    return request.param


@pytest.fixture
def policy(policy_type):
    return where_at_hand(policy_type, make_wrapper, policy_type, replan_interval=2)


def where_at_hand(policy_type, make, *args, **settings):
    """What ``make`` makes, if the type's own packages and pretrained weights are here."""
    try:
        return make(*args, **settings)
    except (ImportError, OSError, ValueError) as missing:
        if policy_type in SMALL:
            raise
        pytest.skip(f"{policy_type}: {str(missing)[:150]}")


def copied(batch):
    return {key: value.clone() for key, value in batch.items()}


def assert_unchanged(batch, before):
    assert batch.keys() == before.keys()
    assert all(torch.equal(batch[key], value) for key, value in before.items())


@pytest.mark.parametrize("name", UNWRAPPABLE)
def test_what_cannot_be_wrapped_is_refused_at_once_and_says_why(name):
    with pytest.raises(ConfigurationError, match=UNWRAPPABLE[name]):
        wrapped_config(name)


def test_a_tdmpc_without_a_planner_has_no_chunks():
    with pytest.raises(ConfigurationError, match="use_mpc=False"):
        make_policy_config("temporal_ensemble", inner={"type": "tdmpc", "use_mpc": False})


@pytest.mark.parametrize("name", OURS)
def test_lerobot_finds_our_classes_by_their_names(name):
    policy_class = get_policy_class(name)
    assert policy_class.name == name
    annotated = inspect.signature(policy_class.__init__).parameters["config"].annotation
    assert isinstance(make_policy_config(name), annotated)


def test_lerobot_finds_the_wrapper_and_its_settings(policy_type):
    inner = SMALL.get(policy_type, {"type": policy_type})
    config = where_at_hand(policy_type, make_policy_config, "temporal_ensemble", inner=inner)
    policy_class = get_policy_class(config.type)
    assert policy_class.name == "temporal_ensemble"
    assert isinstance(config, inspect.signature(policy_class.__init__).parameters["config"].annotation)


def test_it_trains(policy):
    batch = training_batch(policy.config)
    before = copied(batch)
    loss, _ = policy.train().forward(batch)
    loss.backward()
    assert_unchanged(batch, before)
    assert torch.isfinite(loss)
    assert any(p.grad is not None and p.grad.any() for p in policy.parameters())


def test_it_acts_step_by_step_and_begins_anew(policy_type, policy):
    given = observation()
    before = copied(given)
    with torch.inference_mode():
        first = rollout(policy, given)
        policy.reset([1])
        assert policy.select_action(given).shape == (B, A)
    assert_unchanged(given, before)
    assert torch.isfinite(first).all()
    policy.reset()
    again = rollout(policy, given)
    if policy_type not in DRAWS_EACH_EPISODE_ANEW:
        assert torch.equal(again, first)
    assert policy.select_action(observation(batch_size=2)).shape == (2, A)


def rollout(policy, given):
    torch.manual_seed(7)  # LeRobot's generative policies draw from the global generator
    return torch.stack([policy.select_action(given) for _ in range(5)])


def test_chunks_are_as_long_as_the_settings_say(policy):
    chunk = policy.predict_action_chunk(observation())
    assert chunk.shape == (B, policy.config.chunk_size, A)


def test_saved_and_loaded_it_acts_the_same(policy, tmp_path):
    processors = make_pre_post_processors(policy.config, dataset_stats=None)
    for part in (policy, *processors):
        part.save_pretrained(tmp_path)
    loaded = get_policy_class("temporal_ensemble").from_pretrained(tmp_path)
    again = make_pre_post_processors(loaded.config, pretrained_path=str(tmp_path))
    acted = [
        post(rollout(one, pre(observation()))) for one, (pre, post) in ((policy, processors), (loaded, again))
    ]
    assert torch.equal(*acted)
