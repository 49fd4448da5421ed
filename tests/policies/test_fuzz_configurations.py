"""A drawn configuration is refused by our errors before training, or it trains, acts, saves and loads."""

from dataclasses import fields
from typing import get_args

import draccus
import pytest
import torch
from fuzz_configurations import draw, named
from lerobot.configs import PreTrainedConfig
from lerobot.policies.factory import get_policy_class
from policy_cases import MODULES, TYPES, of_every_type
from tiers import draws

from lerobot_act_chunking.errors import ConfigurationError, FeatureError
from lerobot_act_chunking.policies.field_checks import own_fields
from lerobot_act_chunking.ranges import RANGES

B = 3


def batch_of(config, generator):
    steps = () if config.observation_delta_indices is None else (config.n_obs_steps,)
    batch = {
        key: torch.rand(B, *steps, *feature.shape, generator=generator)
        for key, feature in config.input_features.items()
    }
    n_actions = len(config.action_delta_indices)
    batch["action"] = torch.rand(B, n_actions, *config.action_feature.shape, generator=generator)
    is_pad = torch.arange(n_actions) >= torch.tensor([n_actions, n_actions, max(1, n_actions // 2)])[:, None]
    return batch | {"action_is_pad": is_pad}


def frame_of(config, generator):
    return {
        key: torch.rand(B, *feature.shape, generator=generator)
        for key, feature in config.input_features.items()
    }


def build(drawn):
    """The policy of a drawn configuration, or None if ours is the error that refuses it."""
    try:
        config = drawn.config()
        config.validate_features()
        return get_policy_class(drawn.type)(config)
    except (ConfigurationError, FeatureError):
        return None


def live(policy, folder):
    """A step of training, an episode's first actions, a checkpoint; all finite."""
    config, generator = policy.config, torch.Generator().manual_seed(0)
    optimizer = config.get_optimizer_preset().build(policy.get_optim_params())
    scheduler = config.get_scheduler_preset()
    if scheduler is not None:
        scheduler.build(optimizer, num_training_steps=2 * 10**9)  # longer than any phase of it
    policy.train()
    for _ in range(2):  # a tokenizer may take the first
        loss, _metrics = policy.forward(batch_of(config, generator))
        loss.backward()
        optimizer.step()
        optimizer.zero_grad()
        policy.update()
    frames = [frame_of(config, generator) for _ in range(3)]
    policy.reset()
    actions = torch.stack([policy.select_action(frame) for frame in frames])
    policy.reset()
    chunk = policy.predict_action_chunk(frames[0])
    assert actions.isfinite().all()
    assert chunk.isfinite().all()
    policy.save_pretrained(folder)
    back = type(policy).from_pretrained(folder)
    assert draccus.encode(back.config) == draccus.encode(config)
    for name, value in policy.state_dict().items():
        assert torch.equal(value, back.state_dict()[name]), name


@pytest.mark.filterwarnings("ignore")  # a third of the settings is nonsense
@pytest.mark.parametrize("policy_type", TYPES)
def test_a_drawn_configuration_is_refused_at_once_or_lives(policy_type, tmp_path):
    lived = refused = 0
    for seed in range(draws(gate=20, full=5000)):
        drawn = draw(policy_type, seed)
        try:
            policy = build(drawn)
            if policy is not None:
                live(policy, tmp_path)
        except Exception as error:
            error.add_note(f"seed {seed}: {drawn}")
            raise
        lived, refused = lived + (policy is not None), refused + (policy is None)
    assert min(lived, refused) > 0.1 * (lived + refused)


NUMBERS = (int, float)


@pytest.mark.parametrize("policy_type", MODULES)
def test_every_number_has_a_range_and_every_range_a_field(policy_type):
    config_class = PreTrainedConfig.get_choice_class(policy_type)
    for name, hint, _ in own_fields(config_class):
        numbers = hint in NUMBERS or any(each in NUMBERS for each in get_args(hint))
        assert numbers == (name in RANGES), name


def test_no_range_is_left_over():
    classes = [PreTrainedConfig.get_choice_class(name) for name in TYPES]
    names = {each.name for config_class in classes for each in fields(config_class)}
    assert RANGES.keys() <= names


WRONG_KINDS = ("many", [], {}, True, float("nan"), float("inf"), -float("inf"), 10**400)


@pytest.mark.parametrize("policy_type", TYPES)
def test_values_of_another_kind_or_out_of_range_are_refused_by_their_field(policy_type):
    config_class = PreTrainedConfig.get_choice_class(policy_type)
    for name, hint, optional in own_fields(config_class):
        if name not in RANGES:
            continue
        allowed = RANGES[name]
        outside = [allowed.least - 1, allowed.most + 1]
        outside += [allowed.least] * allowed.above + [allowed.most] * allowed.below
        listed = hint not in NUMBERS
        wrong = [kind for kind in WRONG_KINDS if not (listed and kind == [])] + [None] * (not optional)
        wrong += [[each] * 2 for each in outside] if listed else outside
        for value in wrong:
            with pytest.raises(ConfigurationError, match=f"^{name}="):
                config_class(device="cpu", **{name: value})


@pytest.mark.parametrize(("policy_type", "settings", "count", "divisor"), of_every_type("INDIVISIBLE"))
def test_a_count_that_does_not_divide_is_told_what_would(policy_type, settings, count, divisor):
    config_class = PreTrainedConfig.get_choice_class(policy_type)
    with pytest.raises(ConfigurationError, match=f"^{count}=.* must be divisible by {divisor}=") as refusal:
        config_class(device="cpu", **settings)
    advice = str(refusal.value).split(": set ")[1]
    followed = False
    for part in advice.split(", or "):
        name, values = part.removeprefix("--policy.").split(" to ")
        for value in values.split(" or "):
            config_class(device="cpu", **settings | {name: int(value)})
            followed = True
    assert followed


@pytest.mark.parametrize("policy_type", TYPES)
def test_grippers_beyond_the_action_are_refused_when_features_are_known(policy_type):
    with pytest.raises(ConfigurationError, match=r"gripper_dims=\[2\] must be .* dimensions, 0 to 1"):
        named(policy_type, gripper_dims=[2]).config()
    late = named(policy_type, gripper_dims=[1]).config()
    late.gripper_dims = [0, 2]
    with pytest.raises(ConfigurationError, match=r"gripper_dims=\[0, 2\] must be .* dimensions, 0 to 1"):
        late.validate_features()


@pytest.mark.parametrize(("policy_type", "settings", "message"), of_every_type("TOO_COSTLY"))
def test_what_several_settings_cost_together_is_refused_before_it_is_paid(policy_type, settings, message):
    with pytest.raises(ConfigurationError, match=message):
        get_policy_class(policy_type)(named(policy_type, **settings).config())
