"""Every action likelihood with every decoder and every latent: what all of them promise."""

from itertools import product

import pytest
import torch
from policy_cases import ENVIRONMENT, STATE, A, B, Case
from tiers import FULL, some

from lerobot_act_chunking.heads.make import HEADS
from lerobot_act_chunking.heads.regression import RegressionHead
from lerobot_act_chunking.nn.latents.make import LATENTS
from lerobot_act_chunking.policies.act_chunked.modeling_act_chunked import ActChunkedPolicy

T, S = 6, 2  # predictions, of which each query makes two
DECODERS = ("parallel", "autoregressive")
COMBINATIONS = list(product(HEADS, DECODERS, (None, *LATENTS)))
PAIRS = [  # each likelihood with each latent, each of them with each decoder
    (head, DECODERS[(i + j) % 2], latent)
    for (i, head), (j, latent) in product(enumerate(HEADS), enumerate((None, *LATENTS)))
]
IN_THE_GATE = some(8, PAIRS, by=lambda pair: pair[0])  # all of them in the full tier
SMALL = {
    "dim_feedforward": 20,
    "n_encoder_layers": 1,
    "n_vae_encoder_layers": 1,
    "n_decoder_layers": 2,
    "chunk_size": T,
    "actions_per_query": S,
    "teacher_dropout": 0.5,
    "n_components": 3,
    "n_bins": 17,
    "n_latent_components": 7,
    "latent_warmup_steps": 1,
    "kl_weight": 0.1,
}


def make_case(likelihood, decoder, latent):
    """The policy that samples all that it can."""
    settings = {
        **SMALL,
        "action_likelihood": likelihood,
        "decoder_type": decoder,
        "use_vae": latent is not None,
    }
    if latent is not None:
        settings |= {"latent_type": latent, "z_inference": "sample", "z_hold": "chunk"}
    if not issubclass(HEADS[likelihood], RegressionHead):
        settings["action_temperature"] = 1.0
    name = name_of((likelihood, decoder, latent))
    return Case(name, "act_chunked", STATE | ENVIRONMENT, settings)


def name_of(combination):
    return "-".join(map(str, combination))


@pytest.fixture(params=COMBINATIONS if FULL else IN_THE_GATE, ids=name_of)
def case(request):
    return make_case(*request.param)


pairs = pytest.mark.parametrize("case", IN_THE_GATE, ids=name_of, indirect=True)


@pytest.fixture
def policy(case):
    """With parameters off their special initial values, such as zero."""
    return shaken(case)


def shaken(case, **settings):
    policy, generator = case.policy(**settings), torch.Generator().manual_seed(2)
    for parameter in policy.parameters():
        parameter.data += 0.05 * torch.randn(parameter.shape, generator=generator)
    return policy


def make_batch(case, batch_size=B):
    generator = torch.Generator().manual_seed(4)
    actions = 2 * torch.rand(batch_size, T, A, generator=generator) - 1
    is_pad = torch.arange(T) >= torch.tensor([T, 2, 5])[torch.arange(batch_size) % 3, None]
    return case.batch(batch_size) | {"action": actions, "action_is_pad": is_pad}


def test_training_reaches_every_parameter_and_lowers_the_loss(case, policy):
    batch, losses = make_batch(case), []
    optimizer = torch.optim.AdamW(policy.get_optim_params(), lr=5e-3)
    missed = {name for name, _ in policy.named_parameters()}
    policy.train()
    for _ in range(8):
        torch.manual_seed(3)
        loss, _ = policy.forward(batch)
        loss.backward()
        gradients = {name: p.grad for name, p in policy.named_parameters() if p.grad is not None}
        assert all(gradient.isfinite().all() for gradient in gradients.values())
        missed -= {name for name, gradient in gradients.items() if gradient.any()}
        optimizer.step()
        optimizer.zero_grad()
        policy.update()
        losses.append(loss.item())
    assert missed == set()
    assert min(losses[-4:]) < losses[0]


@pairs
def test_losses_of_samples_average_to_the_loss(case, policy):
    mean, each = (policy.eval().forward(make_batch(case), reduction=kind)[0] for kind in ("mean", "none"))
    assert each.shape == (B,)
    torch.testing.assert_close(each.mean(), mean)


@pairs
def test_it_learns_in_mixed_precision(case, policy):
    with torch.autocast("cpu", torch.bfloat16):
        loss, _ = policy.train().forward(make_batch(case))
    loss.backward()
    assert loss.isfinite()
    assert all(p.grad is None or p.grad.isfinite().all() for p in policy.parameters())


def test_actions_are_the_columns_of_chunks(case):
    """Also where fewer queries are decoded, and where chunks are sampled."""
    policy, batch = shaken(case, execution="open_loop", n_action_steps=3), make_batch(case)
    policy.reset(episode_seeds=range(B))
    actions = torch.stack([policy.select_action(batch) for _ in range(6)], dim=1)
    policy.reset(episode_seeds=range(B))
    chunks = [policy.predict_action_chunk(batch)[:, :3] for _ in range(2)]
    torch.testing.assert_close(actions, torch.cat(chunks, dim=1), rtol=1e-5, atol=1e-5)


def test_environments_draw_independently_and_from_generators_of_their_own(case, policy):
    """Each acts as it would alone; where chunks are sampled, those that see the same act differently."""
    one = make_batch(case, 1)
    before = torch.get_rng_state()
    policy.reset(episode_seeds=range(8))
    together = policy.predict_action_chunk({key: x.expand(8, *x.shape[1:]) for key, x in one.items()})
    policy.reset(episode_seeds=range(8))
    alone = [policy.predict_action_chunk(one, envs=[i]) for i in range(2)]
    torch.testing.assert_close(together[:2], torch.cat(alone), rtol=1e-4, atol=1e-5)
    assert torch.equal(torch.get_rng_state(), before)
    differs = (together - together[0]).abs().max() > 1e-4
    assert differs == policy.config.is_stochastic


def test_saved_and_loaded_it_acts_bit_for_bit_the_same(case, policy, tmp_path):
    batch = make_batch(case)
    for _ in range(2):  # what training counts and measures
        policy.train().forward(batch)
        policy.update()
    policy.save_pretrained(tmp_path)
    loaded = ActChunkedPolicy.from_pretrained(tmp_path)
    policy.reset()
    assert loaded.config == policy.config
    for name, value in policy.state_dict().items():
        assert torch.equal(loaded.state_dict()[name], value), name
    for _ in range(2):
        assert torch.equal(loaded.select_action(batch), policy.select_action(batch))


@pairs
def test_one_environment_may_start_a_rollout_alone(case):
    """The others go on as if nothing had happened; it acts as in a first step."""
    policy, batch = (
        shaken(case, execution="ensemble", replan_interval=1, allow_mode_mixing=True),
        make_batch(case),
    )
    later = {key: x + 1 if key.startswith("observation") else x for key, x in batch.items()}
    policy.reset(episode_seeds=[0, 1, 2])
    policy.select_action(batch)
    expected = policy.select_action(later)
    policy.reset(episode_seeds=[3, 4, 5])
    first = policy.select_action(later)
    policy.reset(episode_seeds=[0, 1, 2])
    policy.select_action(batch)
    policy.reset([1], episode_seeds=[4])
    actions = policy.select_action(later)
    torch.testing.assert_close(actions[[0, 2]], expected[[0, 2]])
    torch.testing.assert_close(actions[1], first[1])
    assert not torch.allclose(actions[1], expected[1])


@pytest.mark.parametrize("decoder", DECODERS)
def test_what_is_sharded_exists(decoder):
    """Every class that LeRobot tells FSDP to shard is in the network."""
    classes = {type(module).__name__ for module in make_case("l1", decoder, "gaussian").policy().modules()}
    assert set(ActChunkedPolicy._fsdp_wrap_modules) <= classes
