import itertools
import math

import numpy as np
import torch

from lerobot_act_chunking.policies.act_chunked.draws import ActingDraws

B, N, L, S = 3, 2, 4, (5, 6)


def make(hold_steps=0.0, **settings):
    return ActingDraws(7, **{"n_noise": L, "draws_shape": S} | settings, hold_steps=hold_steps)


def test_there_are_numbers_for_every_chunk_of_every_environment():
    draws = make().draw(B, n_samples=N)
    assert draws.latent.shape == (N, B, L)
    assert draws.actions.shape == (N, B, *S)
    assert 0 <= draws.actions.min() < draws.actions.max() < 1
    flat = draws.flat()
    assert torch.equal(flat.latent[B + 1], draws.latent[1, 1])


def test_what_is_not_sampled_is_not_drawn():
    draws = make(n_noise=None).draw(B)
    assert draws.latent is None
    assert make(draws_shape=None).draw(B).flat().actions is None
    assert torch.equal(draws.actions, make(n_noise=None).draw(B).actions)


def test_environments_draw_on_their_own():
    together, alone = make(), make()
    assert torch.equal(together.draw(B).latent[:, [2]], alone.draw(1, envs=[2]).latent)
    assert torch.equal(together.draw(1, envs=[2]).latent, alone.draw(1, envs=[2]).latent)
    assert not torch.equal(together.draw(B).latent[:, 0], together.draw(B).latent[:, 1])


def test_a_reset_begins_these_environments_anew():
    draws = make(math.inf)
    first = draws.draw(B).latent
    draws.draw(B)
    draws.reset([1])
    again = draws.draw(B).latent
    assert torch.equal(again, first)
    assert not torch.equal(draws.draw(B).actions[:, 0], draws.draw(1, envs=[1]).actions[:, 0])
    draws.reset()
    assert torch.equal(draws.draw(B).latent, make().draw(B).latent)


def test_a_latent_is_held_for_as_long_as_asked():
    def latents(hold_steps):
        draws = make(hold_steps)
        return [draws.draw(B, step=step).latent[0, 0, 0].item() for step in (0, 5, 10, 15)]

    def changes(values):
        return [a != b for a, b in itertools.pairwise(values)]

    assert changes(latents(0)) == [True, True, True]
    assert changes(latents(10)) == [False, True, False]
    assert changes(latents(math.inf)) == [False, False, False]


def test_actions_are_drawn_anew_though_the_latent_is_held():
    draws = make(math.inf)
    assert not torch.equal(draws.draw(B).actions, draws.draw(B).actions)


def test_the_first_of_several_samples_is_the_one_drawn_alone():
    several, alone = make().draw(B, n_samples=N), make().draw(B)
    assert torch.equal(several.latent[0], alone.latent[0])
    assert torch.equal(several.actions[0], alone.actions[0])


def test_another_number_of_samples_draws_another_latent():
    draws = make(math.inf)
    assert draws.draw(B, n_samples=N).latent.shape == (N, B, L)
    assert draws.draw(B).latent.shape == (1, B, L)


def test_choices_do_not_follow_the_latents():
    """Uniforms and normals of one stream are functions of the same bits."""
    source = ActingDraws(3, n_noise=4000, draws_shape=(4000,), hold_steps=0)
    latent, actions = source.draw(1)
    generator = torch.Generator()
    (own,) = source._latents.source.generators(1, [0])
    generator.manual_seed(own.initial_seed())
    generator_of_choices = source._choices.source.generators(1, [0])[0]
    assert generator_of_choices.initial_seed() != own.initial_seed()
    same_stream = torch.rand(4000, generator=generator)
    assert abs(np.corrcoef(actions.ravel(), same_stream)[0, 1]) < 0.1
    assert abs(np.corrcoef(actions.ravel(), latent.ravel())[0, 1]) < 0.1
