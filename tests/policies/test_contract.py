"""What every policy of the package promises to LeRobot and its users."""

import math

import draccus
import pytest
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from policy_cases import CASES, WRAPPED, A, B, T
from tiers import full_tier, some
from torch.nn.parallel import DistributedDataParallel

from lerobot_act_chunking.errors import FeatureError

ALL = [*CASES, *WRAPPED]


def case_id(case):
    return f"{case.type}-{case.name}"


@pytest.fixture(params=some(10, ALL, by=lambda case: case.type), ids=case_id)
def case(request):
    return request.param


def shake(policy):
    """Move parameters off special initial values, such as the zero vector in which all gradients vanish."""
    generator = torch.Generator().manual_seed(2)
    for parameter in policy.parameters():
        parameter.data += 0.05 * torch.randn(parameter.shape, generator=generator)


def loss_and_gradients(policy, batch):
    policy.zero_grad(set_to_none=True)
    torch.manual_seed(3)
    loss, _ = policy.train().forward(batch)
    loss.backward()
    return loss, {name: p.grad for name, p in policy.named_parameters() if p.requires_grad}


def snapshot(batch):
    return {key: value.clone() for key, value in batch.items()}


def assert_unchanged(batch, before):
    assert batch.keys() == before.keys()
    for key, value in before.items():
        assert torch.equal(batch[key], value), key


def test_the_loss_is_finite_and_metrics_are_plain_numbers(case):
    loss, metrics = case.policy().train().forward(case.batch())
    assert loss.shape == ()
    assert math.isfinite(loss.item())
    assert all(type(value) is float for value in metrics.values())


def test_it_trains_in_mixed_precision(case):
    policy = case.policy(dropout=0.1).train()
    with torch.autocast("cpu", torch.bfloat16):
        loss, _ = policy.forward(case.batch())
    loss.backward()
    assert all(p.grad is None or torch.isfinite(p.grad).all() for p in policy.parameters())


def test_it_acts_in_single_precision_in_mixed_precision(case):
    """LeRobot evaluates under autocast, too, and hands the actions to NumPy, which has no bfloat16."""
    policy = case.policy()
    with torch.autocast("cpu", torch.bfloat16):
        assert policy.select_action(case.batch()).dtype == torch.float32
        policy.reset()
        assert policy.predict_action_chunk(case.batch()).dtype == torch.float32


def test_per_sample_losses_average_to_the_loss(case):
    losses = {}
    for reduction in ("mean", "none"):
        policy = case.policy().train()
        torch.manual_seed(3)
        losses[reduction], _ = policy.forward(case.batch(), reduction=reduction)
    assert losses["none"].shape == (B,)
    torch.testing.assert_close(losses["none"].mean(), losses["mean"])


def test_every_parameter_gets_a_gradient(case):
    policy = case.policy()
    shake(policy)
    _, gradients = loss_and_gradients(policy, case.batch())
    without = [name for name, gradient in gradients.items() if gradient is None or not gradient.any()]
    assert without == []


def test_the_optimizer_gets_every_trainable_parameter_once(case):
    policy = case.policy()
    given = [p for group in policy.get_optim_params() for p in group["params"] if p.requires_grad]
    trainable = [p for p in policy.parameters() if p.requires_grad]
    assert len(given) == len(trainable)
    assert set(given) == set(trainable)


def test_padded_actions_change_neither_loss_nor_gradients(case):
    batch = case.batch()
    loss, gradients = loss_and_gradients(case.policy(), batch)
    batch["action"] = torch.where(batch["action_is_pad"][..., None], 7.0, batch["action"])
    other_loss, other_gradients = loss_and_gradients(case.policy(), batch)
    assert torch.equal(loss, other_loss)
    for name, gradient in gradients.items():
        assert torch.equal(gradient, other_gradients[name]), name


def test_the_batch_is_never_changed(case):
    policy, batch = case.policy(), case.batch()
    before = snapshot(batch)
    policy.train().forward(batch)[0].backward()
    policy.predict_action_chunk(batch)
    policy.select_action(batch)
    assert_unchanged(batch, before)


def test_a_fresh_policy_predicts_chunks(case):
    assert case.policy().predict_action_chunk(case.batch()).shape == (B, T, A)


def test_actions_are_the_columns_of_chunks(case):
    policy, batch = case.policy(execution="open_loop", n_action_steps=3), case.batch()
    policy.reset(episode_seeds=range(B))
    chunk = policy.predict_action_chunk(batch)
    policy.reset(episode_seeds=range(B))
    actions = torch.stack([policy.select_action(batch) for _ in range(6)], dim=1)
    torch.testing.assert_close(actions[:, :3], chunk[:, :3])
    policy.reset(episode_seeds=range(B))
    chunks = torch.stack([policy.predict_action_chunk(batch)[:, :3] for _ in range(2)], dim=1)
    torch.testing.assert_close(actions, chunks.flatten(1, 2))


def test_only_a_new_chunk_looks_at_the_observation(case):
    policy, batch = case.policy(execution="open_loop", n_action_steps=3), case.batch()
    policy.reset(episode_seeds=range(B))
    expected = policy.predict_action_chunk(batch)[:, 1]
    policy.reset(episode_seeds=range(B))
    policy.select_action(batch)
    changed = {key: value + 1 if key.startswith("observation") else value for key, value in batch.items()}
    torch.testing.assert_close(policy.select_action(changed), expected)


def test_reset_equals_fresh(case):
    """But for what is drawn, which follows from the episode: here the same."""
    used, fresh, batch = case.policy(), case.policy(), case.batch()
    for _ in range(2):
        used.select_action(batch)
    used.reset(episode_seeds=range(B))
    fresh.reset(episode_seeds=range(B))
    for _ in range(T + 1):
        assert torch.equal(used.select_action(batch), fresh.select_action(batch))


def test_one_environment_may_start_a_rollout_alone(case):
    policy, batch = case.policy(execution="ensemble", replan_interval=3), case.batch()
    undisturbed = case.policy(execution="ensemble", replan_interval=3)
    later = {k: v + 1 if k.startswith("observation") else v for k, v in batch.items()}
    for one in (policy, undisturbed):
        one.select_action(batch)
    policy.reset([1], episode_seeds=[5])
    actions, expected = policy.select_action(later), undisturbed.select_action(later)
    assert torch.equal(actions[[0, 2]], expected[[0, 2]])
    fresh = case.policy()
    fresh.reset(episode_seeds=[4, 5, 6])
    torch.testing.assert_close(actions[1], fresh.predict_action_chunk(later)[1, 0])


def test_a_batch_of_another_size_starts_a_rollout(case):
    policy = case.policy()
    policy.select_action(case.batch())
    assert policy.select_action(case.batch(2)).shape == (2, A)


def test_samples_of_a_batch_are_independent(case):
    policy, batch, noise = case.policy(), case.batch(8), case.noise(8)
    together = policy.predict_action_chunk(batch, **noise)
    policy.reset()
    alone = torch.cat([policy.predict_action_chunk(row(batch, i), **row(noise, i)) for i in range(8)])
    torch.testing.assert_close(together, alone, rtol=1e-4, atol=1e-5)


def test_acting_neither_reads_nor_moves_the_random_generator(case):
    policy, batch, chunks = case.policy(), case.batch(), []
    for seed in (4, 5):
        torch.manual_seed(seed)
        policy.reset(episode_seeds=range(B))
        before = torch.get_rng_state()
        chunks.append(policy.predict_action_chunk(batch))
        assert torch.equal(torch.get_rng_state(), before)
    assert torch.equal(*chunks)


@pytest.fixture
def process_group(tmp_path):
    torch.distributed.init_process_group("gloo", f"file://{tmp_path}/store", world_size=1, rank=0)
    yield
    torch.distributed.destroy_process_group()


def test_it_trains_in_a_distributed_group_as_alone(case, process_group):
    losses = {}
    for name, wrap in (("alone", lambda policy: policy), ("distributed", DistributedDataParallel)):
        policy = case.policy().train()
        model = wrap(policy)
        optimizer = torch.optim.SGD(policy.get_optim_params(), lr=1e-2)
        torch.manual_seed(3)
        losses[name] = []
        for _ in range(2):  # a parameter without gradient stops the second one
            loss, _ = model(case.batch())
            loss.backward()
            optimizer.step()
            optimizer.zero_grad()
            policy.update()
            losses[name].append(loss.item())
    assert losses["distributed"] == losses["alone"]


def test_a_missing_observation_is_named(case):
    policy, batch = case.policy(), case.batch()
    key = next(iter(case.inputs))
    del batch[key]
    for use in (policy.forward, policy.predict_action_chunk, policy.select_action):
        with pytest.raises(FeatureError, match=f"needs '{key}', but the batch has only"):
            use(batch)


def test_saved_and_loaded_it_acts_bit_for_bit_the_same(case, tmp_path):
    policy = case.policy()
    shake(policy)
    preprocessor, postprocessor = make_pre_post_processors(policy.config, dataset_stats=statistics(case))
    for part in (policy, preprocessor, postprocessor):
        part.save_pretrained(tmp_path)
    loaded = get_policy_class(case.type).from_pretrained(tmp_path)
    processors = make_pre_post_processors(loaded.config, pretrained_path=str(tmp_path))
    raw = {key: value * 3 for key, value in case.batch().items() if key.startswith("observation")}
    actions = [
        post(one.select_action(pre(raw)))
        for one, (pre, post) in ((policy, (preprocessor, postprocessor)), (loaded, processors))
    ]
    assert torch.equal(*actions)


def statistics(case):
    """Statistics with which normalising does something."""
    config = case.config()
    features = {**config.input_features, **config.output_features}
    shapes = {key: (3, 1, 1) if "image" in key else feature.shape for key, feature in features.items()}
    return {
        key: {
            name: torch.full(shape, value)
            for name, value in {"mean": 0.3, "std": 0.7, "min": -1.5, "max": 2.0}.items()
        }
        for key, shape in shapes.items()
    }


def test_the_config_survives_json_and_the_command_line(case, tmp_path):
    config = case.config()
    config.save_pretrained(tmp_path)
    assert PreTrainedConfig.from_pretrained(tmp_path) == config
    changed = PreTrainedConfig.from_pretrained(tmp_path, cli_overrides=["--n_action_steps=2"])
    assert changed.n_action_steps == 2
    assert draccus.encode(changed, PreTrainedConfig)["type"] == case.type


LEARNS_IN_THE_GATE = {"state"}
"""Names of cases; the others take minutes together and learn in `.ci/full`."""


@pytest.mark.parametrize(
    "learner",
    [
        pytest.param(case, id=case_id(case), marks=() if case.name in LEARNS_IN_THE_GATE else full_tier)
        for case in ALL
    ],
)
def test_it_learns_eight_samples_by_heart(learner):
    case, policy = learner, learner.larger_policy()
    batch = {key: plain(value) if "image" in key else value for key, value in case.batch(8).items()}
    optimizer = torch.optim.AdamW([p for p in policy.parameters() if p.requires_grad], lr=3e-3)
    first = chunk_error(policy, batch)
    policy.train()
    for _ in range(case.n_training_steps):
        policy.forward(batch)[0].backward()
        optimizer.step()
        optimizer.zero_grad()
        policy.update()
    assert chunk_error(policy, batch) < 0.25 * first


def chunk_error(policy, batch):
    policy.reset()
    error = (policy.predict_action_chunk(batch) - batch["action"]).abs()
    return error[~batch["action_is_pad"]].mean()


def row(batch, i):
    return {key: value[i : i + 1] for key, value in batch.items()}


def plain(images):
    """Images of one colour: what differs between noise images takes long to learn."""
    return images[..., :1, :1].expand_as(images)
