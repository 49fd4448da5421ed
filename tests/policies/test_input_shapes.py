"""Inputs of every rank and size: a policy takes them, or refuses them by their own name.

LeRobot stores features of one value as scalars: (B,) in a batch, (B, T) with a time axis.
"""

from functools import cache
from itertools import product

import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from policy_cases import SIZES, Case, T
from tiers import some

from lerobot_act_chunking.errors import FeatureError

STATE, SENSOR, CAMERA = "observation.state", "observation.gripper", "observation.images.top"
SHAPES = {STATE: (2,), SENSOR: (1,), CAMERA: (3, 18, 21)}
TYPES = tuple(SIZES)


@cache
def make(policy_type, n_obs_steps, action_dim, state_dim=2):
    shapes = SHAPES | {STATE: (state_dim,)}
    kinds = {STATE: FeatureType.STATE, SENSOR: FeatureType.STATE, CAMERA: FeatureType.VISUAL}
    config = Case("shapes", policy_type, {}).config(n_obs_steps=n_obs_steps)
    config.input_features = {key: PolicyFeature(kinds[key], shape) for key, shape in shapes.items()}
    config.output_features = {"action": PolicyFeature(FeatureType.ACTION, (action_dim,))}
    torch.manual_seed(0)
    policy = get_policy_class(policy_type)(config)
    policy.train()
    while policy_type == "vqbet_chunked" and policy.tokenizer_phase.comes_first:
        policy.forward(batch_of(policy, 5))
    return policy


def batch_of(policy, batch_size, *, time=True):
    """A batch as its features say; with one observed step, without the time axis unless asked for."""
    config, generator = policy.config, torch.Generator().manual_seed(batch_size)
    steps = (config.n_obs_steps,) if time else ()
    n_actions = len(config.action_delta_indices)
    shapes = {key: (*steps, *feature.shape) for key, feature in config.input_features.items()}
    shapes["action"] = (n_actions, *config.action_feature.shape)
    batch = {key: torch.rand(batch_size, *shape, generator=generator) for key, shape in shapes.items()}
    return batch | {"action_is_pad": torch.zeros(batch_size, n_actions, dtype=torch.bool)}


def train(policy, batch):
    return policy.train().forward(batch)[0]


def act(policy, batch):
    policy.reset()
    return policy.select_action(batch)


def predict(policy, batch):
    policy.reset()
    return policy.predict_action_chunk(batch)


def outcome(use, policy, batch):
    try:
        return use(policy, batch)
    except FeatureError as error:
        return error


USES = {train: True, act: False, predict: False, "predict a window": True}


def shapes_near(shape, n_obs_steps, batch_size):
    """Every rank from 0 to two beyond that of ``shape``, with right and wrong sizes."""
    leads = [(), (1,), (batch_size,), (batch_size + 1,), (batch_size, 1), (1, batch_size)]
    leads += [(batch_size, n_obs_steps), (batch_size, n_obs_steps + 1), (batch_size, n_obs_steps, 1)]
    ends = [(), shape, shape[:-1], (*shape[:-1], shape[-1] + 1), (*shape, 1), (0,)]
    return sorted({(*lead, *end) for lead, end in product(leads, ends)})


@pytest.mark.parametrize(
    ("policy_type", "use", "n_obs_steps"),
    some(9, product(TYPES, USES, [1, 2]), by=lambda case: case[:2]),
    ids=lambda value: getattr(value, "__name__", str(value)).replace(" ", "_"),
)
def test_every_shape_is_taken_or_refused_by_its_own_name(policy_type, use, n_obs_steps):
    policy, taken, refused = make(policy_type, n_obs_steps, 3), 0, 0
    for batch_size in (1, 4):
        good = batch_of(policy, batch_size, time=USES[use])
        keys = [*SHAPES, "action", "action_is_pad"] if use is train else SHAPES
        for key in keys:
            shape = tuple(good[key].shape[1:]) if key not in SHAPES else SHAPES[key]
            for near in shapes_near(shape, n_obs_steps, batch_size):
                batch = good | {key: torch.zeros(near, dtype=good[key].dtype)}
                result = outcome(use if callable(use) else predict, policy, batch)
                if isinstance(result, FeatureError):
                    assert repr(key) in str(result), (key, near)
                    refused += 1
                else:
                    assert torch.isfinite(result).all(), (key, near)
                    taken += 1
    assert taken >= 2 * len(SHAPES)
    assert refused > taken


@pytest.mark.parametrize("value", [None, 3, [0.1, 0.2], "open", torch.tensor(0.5)], ids=str)
@pytest.mark.parametrize("policy_type", TYPES)
def test_what_is_no_batch_of_tensors_is_refused_by_its_name(policy_type, value):
    policy = make(policy_type, 1, 3)
    for use in (train, act, predict):
        with pytest.raises(FeatureError, match=f"'{SENSOR}'"):
            use(policy, batch_of(policy, 4, time=False) | {SENSOR: value})


@pytest.mark.parametrize(("action_dim", "state_dim"), [(1, 2), (3, 1), (1, 1)])
@pytest.mark.parametrize("batch_size", [1, 4])
@pytest.mark.parametrize("n_obs_steps", [1, 2])
@pytest.mark.parametrize("policy_type", TYPES)
def test_features_of_one_value_train_and_act_as_lerobot_makes_them(
    policy_type, n_obs_steps, batch_size, action_dim, state_dim
):
    policy = make(policy_type, n_obs_steps, action_dim, state_dim)
    before, behind = make_pre_post_processors(policy.config, dataset_stats=statistics(policy))
    batch = batch_of(policy, batch_size, time=n_obs_steps > 1)
    loaded = {key: value.squeeze(-1) if value.shape[-1] == 1 else value for key, value in batch.items()}
    assert loaded[SENSOR].shape == ((batch_size,) if n_obs_steps == 1 else (batch_size, n_obs_steps))
    losses = [train(policy, before(each)).isfinite() for each in (dict(loaded), dict(batch))]
    assert all(losses)

    frame = batch_of(policy, batch_size, time=False)
    for key in ("action", "action_is_pad"):
        del frame[key]
    policy.reset()
    action = behind(policy.select_action(before(frame)))
    assert action.shape == (batch_size, action_dim)
    assert predict(policy, before(frame)).shape == (batch_size, T, action_dim)


def statistics(policy):
    features = policy.config.input_features | policy.config.output_features
    ones = {
        key: torch.ones(f.shape if f.type is not FeatureType.VISUAL else (3, 1, 1))
        for key, f in features.items()
    }
    return {key: {"mean": 0 * one, "std": 2 * one, "min": -one, "max": one} for key, one in ones.items()}


@pytest.mark.parametrize("n_obs_steps", [1, 2])
@pytest.mark.parametrize("policy_type", TYPES)
def test_a_value_counts_the_same_with_and_without_its_axis(policy_type, n_obs_steps):
    policy = make(policy_type, n_obs_steps, 1, 1)
    window = batch_of(policy, 4)
    scalars = window | {key: window[key].squeeze(-1) for key in (STATE, SENSOR)}
    expected = policy._window_of(window).vectors
    for key, value in policy._window_of(scalars).vectors.items():
        assert torch.equal(value, expected[key])


@pytest.mark.parametrize("policy_type", TYPES)
def test_a_time_axis_of_one_step_may_stand_on_some_inputs_alone(policy_type):
    policy = make(policy_type, 1, 3)
    batch = batch_of(policy, 4, time=False)
    for key in SHAPES:
        mixed = batch | {key: batch[key][:, None]}
        assert train(policy, mixed).isfinite()
        assert act(policy, mixed).isfinite().all()
        windows = (policy._window_of(each) for each in (mixed, batch))
        ours, expected = ({**each.vectors, **each.images}[key] for each in windows)
        assert torch.equal(ours, expected)


@pytest.mark.parametrize("shape", [(), (0,), (2, 3), (1, 1), (0, 2)])
@pytest.mark.parametrize("key", [STATE, "action"])
@pytest.mark.parametrize("policy_type", TYPES)
def test_features_that_are_no_vectors_are_refused_by_their_name(policy_type, key, shape):
    config = Case("shapes", policy_type, {STATE: PolicyFeature(FeatureType.STATE, (2,))}).config()
    features = config.input_features if key == STATE else config.output_features
    features[key] = PolicyFeature(features[key].type, shape)
    with pytest.raises(FeatureError, match=f"'{key}' must be a vector"):
        config.validate_features()
