import pytest
import torch

from lerobot_act_chunking.data.batch import ActionTarget, FeatureSpec, Observation, first_non_finite
from lerobot_act_chunking.errors import FeatureError

B, T, A, S = 3, 5, 4, 6
SPEC = FeatureSpec(
    vectors={"observation.state": (S,)}, images={"observation.images.top": (3, 8, 9)}, action=(A,)
)


@pytest.fixture
def batch():
    return {
        "observation.state": torch.randn(B, S),
        "observation.images.top": torch.rand(B, 3, 8, 9),
        "action": torch.randn(B, T, A),
        "action_is_pad": torch.zeros(B, T, dtype=torch.bool),
        "task": ["lift"] * B,
    }


def test_picks_what_the_policy_reads(batch):
    observation = Observation.from_lerobot(batch, SPEC)
    assert torch.equal(observation.vectors["observation.state"], batch["observation.state"])
    assert torch.equal(observation.images["observation.images.top"], batch["observation.images.top"])
    assert observation.batch_size == B
    target = ActionTarget.from_lerobot(batch, SPEC, range(T))
    assert torch.equal(target.actions, batch["action"])
    assert torch.equal(target.is_pad, batch["action_is_pad"])


@pytest.mark.parametrize("first", [0, -1, 2])
@pytest.mark.parametrize("strides", [(1, 1), (2,), (2, 1), (1, 2)], ids=str)
def test_steps_are_found_among_all_from_the_first_of_them_on(batch, first, strides):
    steps = [first]
    for stride in strides:
        steps.append(steps[-1] + stride)
    target = ActionTarget.from_lerobot(batch, SPEC, steps)
    places = [step - first for step in steps]
    assert torch.equal(target.actions, batch["action"][:, places])
    alone = {**batch, "action": target.actions, "action_is_pad": target.is_pad}
    again = ActionTarget.from_lerobot(alone, SPEC, steps)
    assert torch.equal(again.actions, target.actions)
    assert torch.equal(again.is_pad, batch["action_is_pad"][:, places])


def test_too_few_steps_are_refused(batch):
    with pytest.raises(FeatureError, match=r"'action' has shape \(3, 5, 4\), .* built for \(B, 3, 4\)"):
        ActionTarget.from_lerobot(batch, SPEC, [0, 3, 6])


def test_batch_size_without_vectors(batch):
    spec = FeatureSpec(vectors={}, images=SPEC.images, action=SPEC.action)
    assert Observation.from_lerobot(batch, spec).batch_size == B


@pytest.mark.parametrize("key", ["observation.state", "observation.images.top", "action", "action_is_pad"])
def test_a_missing_key_is_named_beside_what_there_is(batch, key):
    del batch[key]
    present = ", ".join(sorted(batch))
    with pytest.raises(FeatureError, match=f"needs '{key}', but the batch has only: {present}"):
        (Observation.from_lerobot(batch, SPEC), ActionTarget.from_lerobot(batch, SPEC, range(T)))


def test_another_shape_is_named_beside_the_expected_one(batch):
    batch["observation.state"] = torch.randn(B, 7)
    with pytest.raises(FeatureError, match=r"'observation.state' has shape \(3, 7\), .* built for \(B, 6\)"):
        Observation.from_lerobot(batch, SPEC)
    with pytest.raises(FeatureError, match=r"'action' has shape \(3, 5, 4\), .* built for \(B, 9, 4\)"):
        ActionTarget.from_lerobot(batch, SPEC, range(9))


def test_first_non_finite(batch):
    assert first_non_finite(batch, SPEC.keys) is None
    batch["action"][1, 2, 3] = torch.inf
    assert first_non_finite(batch, SPEC.keys) == "action"
    batch["observation.state"][0, 0] = torch.nan
    assert first_non_finite(batch, SPEC.keys) == "observation.state"


def test_what_is_not_read_may_hold_anything(batch):
    batch["observation.current"] = torch.full((B, 2), torch.nan)
    assert first_non_finite(batch, SPEC.keys) is None
