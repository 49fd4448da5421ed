"""`resize_shape` and `crop_shape` of every type: what is seen, in training and when acting."""

import draccus
import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from lerobot.policies.factory import get_policy_class
from policy_case import Case
from policy_cases import SIZES

from lerobot_act_chunking.errors import ConfigurationError, FeatureError
from lerobot_act_chunking.nn.image_view import resize

TYPES = tuple(SIZES)
TOP, WRIST, STATE = "observation.images.top", "observation.images.wrist", "observation.state"
INPUTS = {
    STATE: PolicyFeature(FeatureType.STATE, (6,)),
    TOP: PolicyFeature(FeatureType.VISUAL, (3, 60, 80)),
    WRIST: PolicyFeature(FeatureType.VISUAL, (3, 40, 44)),
}
SEEDS = [0, 1, 2]  # of the episodes: what is drawn while acting
VIEW = {"resize_shape": (36, 48), "crop_shape": (32, 40)}


def make(policy_type, **settings):
    policy = Case("views", policy_type, INPUTS, settings).policy()
    while policy_type == "vqbet_chunked" and policy.tokenizer_phase.comes_first:
        policy.train().forward(batch_of(policy))
    return policy


def batch_of(policy, size=None):
    generator = torch.Generator().manual_seed(1)
    batch = {key: torch.rand(3, *each.shape, generator=generator) for key, each in INPUTS.items()}
    if size is not None:
        batch |= {key: resize(batch[key], size) for key in (TOP, WRIST)}
    n_actions = len(policy.config.action_delta_indices)
    batch["action"] = torch.rand(3, n_actions, 4, generator=generator)
    return batch | {"action_is_pad": torch.zeros(3, n_actions, dtype=torch.bool)}


def loss_of(policy, batch):
    torch.manual_seed(5)
    return policy.forward(batch)[0]


@pytest.fixture(scope="module", params=TYPES)
def policy(request):
    return make(request.param, **VIEW)


def test_frames_may_come_resized(policy):
    whole, resized = batch_of(policy), batch_of(policy, VIEW["resize_shape"])
    policy.eval()
    assert torch.equal(loss_of(policy, whole), loss_of(policy, resized))
    actions = []
    for batch in (whole, resized):
        policy.reset(episode_seeds=SEEDS)
        actions.append(policy.select_action(batch))
    assert torch.equal(*actions)


def test_only_the_middle_counts_when_acting(policy):
    batch = batch_of(policy, VIEW["resize_shape"])
    border = {key: batch[key].clone() for key in (TOP, WRIST)}
    for image in border.values():
        image[..., :2, :] = image[..., -2:, :] = image[..., :4] = image[..., -4:] = 9.0
    policy.reset(episode_seeds=SEEDS)
    before = policy.predict_action_chunk(batch)
    policy.reset(episode_seeds=SEEDS)
    assert torch.equal(policy.predict_action_chunk(batch | border), before)


def test_training_sees_other_parts_each_time_and_evaluation_the_same(policy):
    batch = batch_of(policy)
    n_batches = int(policy.crop_seeds.n_batches)
    losses = [loss_of(policy.eval(), batch) for _ in range(2)]
    assert torch.equal(*losses)
    loss_of(policy.train(), batch)
    assert int(policy.crop_seeds.n_batches) == n_batches + 1  # what a resumed run goes on from
    windows = [policy._training_window(batch, Target(batch)).images[TOP] for _ in range(2)]
    assert windows[0].shape[-2:] == VIEW["crop_shape"]
    assert not torch.equal(*windows)


class Target:
    """The actions of a batch."""

    def __init__(self, batch):
        self.actions = batch["action"]


def test_a_checkpoint_sees_what_its_policy_saw(policy, tmp_path):
    policy.save_pretrained(tmp_path)
    loaded = get_policy_class(policy.name).from_pretrained(tmp_path)
    assert loaded.config.image_view == policy.config.image_view
    assert PreTrainedConfig.from_pretrained(tmp_path).crop_is_random
    batch = batch_of(policy)
    actions = []
    for each in (policy, loaded):
        each.reset(episode_seeds=SEEDS)
        actions.append(each.select_action(batch))
    assert torch.equal(*actions)


def test_a_camera_of_another_size_is_still_refused(policy):
    batch = batch_of(policy) | {TOP: torch.rand(3, 3, 30, 40)}
    with pytest.raises(FeatureError, match=r"built for \(B, 3, 60, 80\)"):
        policy.select_action(batch)


@pytest.mark.parametrize("policy_type", TYPES)
def test_without_them_nothing_is_drawn_and_nothing_more_is_saved(policy_type):
    plain = make(policy_type)
    assert plain.crop_seeds is None
    assert not any("crop" in name for name in plain.state_dict())
    fixed = Case("views", policy_type, INPUTS, VIEW | {"crop_is_random": False}).policy()
    assert fixed.crop_seeds is None
    batch = batch_of(plain)
    window = plain._training_window(batch, Target(batch))
    assert torch.equal(window.images[TOP][:, -1], batch[TOP])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            VIEW | {"crop_shape": (32, 50)},
            r"=\[32, 50\] does not fit into resize_shape, .*\[36, 48\]",
        ),
        (
            {"crop_shape": (50, 44)},
            r"\[40, 44\]: set --policy.crop_shape='\[40, 44\]'",
        ),
        ({"resize_shape": (0, 48)}, r"resize_shape=\(0, 48\) must be at least 1"),
        ({"resize_shape": (36,)}, "must be a list of 2 values"),
    ],
)
def test_sizes_that_cannot_work(settings, message):
    with pytest.raises(ConfigurationError, match=message):
        Case("views", TYPES[0], INPUTS, settings).policy()


def test_they_are_lerobots_arguments():
    config_class = PreTrainedConfig.get_choice_class(TYPES[0])
    args = ["--resize_shape=[240, 320]", "--crop_shape=[224, 300]", "--crop_is_random=false", "--device=cpu"]
    config = draccus.parse(config_class, args=args)
    assert (config.image_view.resize_shape, config.image_view.crop_shape) == ((240, 320), (224, 300))
    assert config.crop_is_random is False
