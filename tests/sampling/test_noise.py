import pytest
import torch

from lerobot_act_chunking.sampling.noise import NoiseHold, NoiseSource

B, T, A = 3, 5, 4


def test_an_environments_noise_does_not_depend_on_the_others():
    together = NoiseSource(7).draw(B, (T, A))
    source = NoiseSource(7)
    assert torch.equal(source.draw(1, (T, A), envs=[2])[0], together[2])
    assert torch.equal(source.draw(1, (T, A), envs=torch.tensor([0]))[0], together[0])
    assert together.shape == (B, T, A)


def test_environments_and_seeds_differ():
    noise = torch.cat([NoiseSource(seed).draw(B, (T, A)) for seed in (0, 1, 2)]).flatten(1)
    assert torch.corrcoef(noise).fill_diagonal_(0).abs().max() < 0.8
    assert len(noise.unique(dim=0)) == 9


def test_noise_goes_on_until_reset():
    """Within an episode; which one it is, its `Episodes` decide."""
    source = NoiseSource(7)
    first, second = source.draw(B, (T, A)), source.draw(B, (T, A))
    assert not torch.equal(first, second)
    source.reset([1])
    third = source.draw(B, (T, A))
    assert torch.equal(third[1], first[1])
    assert not torch.equal(third[0], first[0])
    source.reset()
    assert torch.equal(source.draw(B, (T, A)), first)
    source.episodes.begin()
    source.reset()
    assert not torch.equal(source.draw(B, (T, A)), first)


def test_resetting_what_never_drew_does_no_harm():
    source = NoiseSource(7)
    source.reset([5])
    NoiseHold(source).reset([5])
    assert torch.equal(source.draw(B, (T, A)), NoiseSource(7).draw(B, (T, A)))


def test_samples_are_major_and_the_first_is_the_one_drawn_alone():
    samples = NoiseSource(7).draw(B, (T, A), n_samples=2)
    assert samples.shape == (2 * B, T, A)
    source = NoiseSource(7)
    assert torch.equal(samples[:B], source.draw(B, (T, A)))
    assert torch.equal(samples[B:], source.draw(B, (T, A)))
    generators = source.generators(B, n_samples=2)
    assert [id(generator) for generator in generators[:B]] == [id(generator) for generator in generators[B:]]


def test_no_global_generator_is_read_or_moved():
    torch.manual_seed(0)
    state = torch.random.get_rng_state()
    first = NoiseSource(7).draw(B, (T, A))
    assert torch.equal(torch.random.get_rng_state(), state)
    torch.manual_seed(1)
    assert torch.equal(NoiseSource(7).draw(B, (T, A)), first)


def test_noise_is_standard_normal():
    noise = NoiseSource(7).draw(B, (1000, A))
    assert noise.mean().item() == pytest.approx(0, abs=0.05)
    assert noise.std().item() == pytest.approx(1, abs=0.05)
    held = NoiseHold(NoiseSource(7)).draw(B, (1000, A), 0)
    assert held.std().item() == pytest.approx(1, abs=0.05)


def test_held_noise_stays_with_its_keyframe():
    hold = NoiseHold(NoiseSource(7))
    first, second = hold.draw(B, (T, A), 10), hold.draw(B, (T, A), 12)
    assert torch.equal(second[:, : T - 2], first[:, 2:])
    assert not torch.equal(second[:, T - 2 :], first[:, :2])
    assert torch.equal(hold.draw(B, (T, A), 12), second)


@pytest.mark.parametrize("rhythm", [(0, 7), (0, 1, 7), (0, 2, 3, 7), (0, 5, 7)])
def test_held_noise_does_not_depend_on_the_rhythm(rhythm: tuple[int, ...]):
    long = NoiseHold(NoiseSource(7)).draw(B, (20, A), 0)
    hold = NoiseHold(NoiseSource(7))
    for first in rhythm:
        noise = hold.draw(B, (T, A), first)
        assert torch.equal(noise, long[:, first : first + T])


def test_held_noise_of_an_environment_does_not_depend_on_the_others():
    together, apart = NoiseHold(NoiseSource(7)), NoiseHold(NoiseSource(7))
    expected = [together.draw(B, (T, A), first) for first in (0, 2)]
    assert torch.equal(apart.draw(1, (T, A), 0, envs=[1])[0], expected[0][1])
    assert torch.equal(apart.draw(2, (T, A), 2, envs=torch.tensor([0, 1]))[1], expected[1][1])


def test_a_reset_environment_gets_the_noise_of_a_fresh_one():
    source = NoiseSource(7)
    hold = NoiseHold(source)
    first = hold.draw(B, (T, A), 0)
    hold.draw(B, (T, A), 3)
    source.reset([1])
    hold.reset([1])
    again = hold.draw(B, (T, A), 4)
    assert torch.equal(again[1], first[1])
    assert torch.equal(again[0, : T - 4], first[0, 4:])


def test_a_shorter_chunk_leaves_the_rest_held():
    hold = NoiseHold(NoiseSource(7))
    first = hold.draw(B, (T, A), 0)
    assert torch.equal(hold.draw(B, (2, A), 1), first[:, 1:3])
    assert torch.equal(hold.draw(B, (T, A), 1)[:, : T - 1], first[:, 1:])


def test_held_noise_does_not_go_back():
    hold = NoiseHold(NoiseSource(7))
    hold.draw(B, (T, A), 4)
    with pytest.raises(
        ValueError, match=r"keyframe 3 of environment 0 lies before .* began at 4: reset first"
    ):
        hold.draw(B, (T, A), 3)
