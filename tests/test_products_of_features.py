"""What only two features together bring out, and random streams that must not be one another's."""

import os
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from lerobot_act_chunking.cli.quickstart import QuickstartPlan
from lerobot_act_chunking.data.masking import hold_padding
from lerobot_act_chunking.diagnostics.latent.encoding import Encoded
from lerobot_act_chunking.diagnostics.latent.figures import share_outside
from lerobot_act_chunking.diagnostics.steps.statistics import spread
from lerobot_act_chunking.durable_files import write_atomically
from lerobot_act_chunking.envs.robotics.env import RoboticsEnv
from lerobot_act_chunking.policies.act_chunked.draws import ActingDraws
from lerobot_act_chunking.policies.batch_seeds import BatchSeeds
from lerobot_act_chunking.policies.diffusion_chunked.plan import Plan
from lerobot_act_chunking.recording.simulated import noise_stream
from lerobot_act_chunking.sampling.solvers import LinearSampler, Step

NUMBERS = 4000


@pytest.mark.parametrize(
    ("is_pad", "held"),
    [
        ([1, 1, 0, 0, 0], [2, 2, 2, 3, 4]),
        ([0, 0, 0, 1, 1], [0, 1, 2, 2, 2]),
        ([1, 0, 0, 1, 1], [1, 1, 2, 2, 2]),
    ],
)
def test_padding_before_and_behind_an_episode_repeats_its_nearest_step(is_pad, held):
    actions = torch.arange(5.0)[None, :, None].expand(2, 5, 3)
    found = hold_padding(actions, torch.tensor([is_pad, [0] * 5]).bool())
    assert found[0, :, 0].tolist() == held
    assert torch.equal(found[1], actions[1])


def test_a_success_does_not_outlive_its_episode():
    env = RoboticsEnv(task="FetchReach-v4", success="any", obs_type="state")
    succeeds = iter([True, False, False])
    env.layout = SimpleNamespace(
        **{name: getattr(env.layout, name) for name in dir(env.layout) if not name.startswith("__")}
    )
    env.layout.succeeds = lambda _: next(succeeds)
    try:
        env.reset(seed=0)
        terminated = [env.step(np.zeros(4, np.float32))[2]]
        env.reset(seed=1)
        terminated += [env.step(np.zeros(4, np.float32))[2] for _ in range(2)]
    finally:
        env.close()
    assert terminated == [True, False, False]


def test_the_first_prediction_behind_the_delay_is_not_frozen():
    steps = torch.arange(14.0).reshape(2, 7, 1)
    plan = Plan.from_steps(steps, torch.ones(1, 7, dtype=torch.bool), horizon=5, chunk_stride=1, delay=2)
    assert plan.frozen.tolist() == [[True, True, False, False, False]] * 2


def correlation(one, other):
    return abs(np.corrcoef(np.ravel(one), np.ravel(other))[0, 1])


def test_choices_do_not_follow_the_latents():
    """Uniforms and normals of one stream are functions of the same bits."""
    source = ActingDraws(3, n_noise=NUMBERS, draws_shape=(NUMBERS,), hold_steps=0)
    latent, actions = source.draw(1)
    generator = torch.Generator()
    (own,) = source._latents.source.generators(1, [0])
    generator.manual_seed(own.initial_seed())
    generator_of_choices = source._choices.source.generators(1, [0])[0]
    assert generator_of_choices.initial_seed() != own.initial_seed()
    same_stream = torch.rand(NUMBERS, generator=generator)
    assert correlation(actions, same_stream) < 0.1
    assert correlation(actions, latent) < 0.1


def test_the_expert_does_not_draw_the_environments_numbers():
    for seed in (0, 1, 1000):
        expert, environment = noise_stream(seed), np.random.default_rng(seed)
        assert correlation(expert.normal(size=NUMBERS), environment.normal(size=NUMBERS)) < 0.1


def test_multistep_solvers_carry_the_clipped_estimate_over():
    """DPM-Solver++ with a network whose every estimate is outside of the range."""
    steps = (Step(of_x=0.5, of_clean=0.5), Step(of_x=0.5, of_clean=1.0, of_previous=-0.25))
    sampler = LinearSampler(times=torch.tensor([0.9, 0.4]), clip=1.0, steps=steps)
    found = sampler(lambda x, _: torch.full_like(x, 9.0), torch.zeros(1, 2, 3))
    assert torch.allclose(found, torch.full_like(found, 0.5 * 0.5 + 1.0 - 0.25))


def test_ranks_of_a_distributed_run_draw_apart(monkeypatch):
    seeds = {}
    monkeypatch.setattr(torch.distributed, "is_initialized", lambda: True)
    for rank in (0, 1, 2):
        monkeypatch.setattr(torch.distributed, "get_rank", lambda rank=rank: rank)
        source = BatchSeeds()
        source.seed.fill_(7)  # from the checkpoint or the broadcast of the first rank
        seeds[rank] = [source.next_seed() for _ in range(3)]
    drawn = [seed for each in seeds.values() for seed in each]
    assert len(set(drawn)) == len(drawn)


def test_a_tokenizer_file_is_replaced_whole_or_not_at_all(tmp_path, monkeypatch):
    path = tmp_path / "tokenizer.safetensors"
    write_atomically(path, b"the old one")
    in_place = []

    def crash(_):
        in_place.append(path.read_bytes())
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", crash)
    with pytest.raises(KeyboardInterrupt):
        write_atomically(path, b"the new one")
    assert in_place == [b"the old one"]
    assert path.read_bytes() == b"the old one"
    assert list(tmp_path.iterdir()) == [path]


def test_styles_are_far_in_units_of_each_dimension():
    """What is outside does not change with the units of a dimension."""
    rng = np.random.default_rng(0)
    z, drawn = rng.normal(size=(600, 2)), rng.normal(size=(400, 2))
    drawn[:100, 1] += 8  # outside, in the dimension that the second case shrinks
    episode = np.arange(600) // 60
    shares = []
    for units in ([1.0, 1.0], [50.0, 0.5]):
        mean = z * units
        encoded = Encoded(mean=mean, divergence=np.ones((600, 2)), z=mean, prior=mean, mode=0 * mean)
        shares.append(share_outside(drawn * units, encoded, episode))
    assert shares[0] == pytest.approx(shares[1])
    assert shares[0] == pytest.approx(0.25, abs=0.05)


def test_the_spread_of_few_samples_is_unbiased():
    """Two samples at -1 and 1 come from a variance of 2, as the mean of many such pairs has it."""
    pair = np.array([-1.0, 1.0]).reshape(2, 1, 1, 1)
    assert spread(pair)[0] == pytest.approx(np.sqrt(2))
    modes = np.concatenate((pair, pair + 50))
    assert spread(modes, np.array([0, 0, 1, 1]))[0] == pytest.approx(np.sqrt(2))


def test_trained_means_pushed(tmp_path, monkeypatch):
    monkeypatch.setenv("LEROBOT_LOCAL_HUB", str(tmp_path / "hub"))
    story = QuickstartPlan(tmp_path, steps=3)
    (story.train / "checkpoints" / "000003").mkdir(parents=True)
    assert not story.trained()
    main = story.hub / f"models--{story.policy_repo_id.replace('/', '--')}" / "refs" / "main"
    main.parent.mkdir(parents=True)
    main.write_text("0" * 40)
    assert story.trained()
