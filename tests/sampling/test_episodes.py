"""A random stream belongs to (seed, environment, episode), or to (seed, the episode's own seed)."""

import itertools
import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from policy_cases import of_every_type
from tiers import draws

from lerobot_act_chunking.sampling.episodes import Episodes
from lerobot_act_chunking.sampling.held_draws import HeldDraws
from lerobot_act_chunking.sampling.noise import NoiseHold, NoiseSource

N_ENVS, N = 4, 6


class Noise:
    """`diffusion_chunked`'s draws."""

    def __init__(self, seed, episodes):
        self.source = NoiseSource(seed, episodes)

    def reset(self, envs):
        self.source.reset(envs)

    def draw(self, env):
        return self.source.draw(1, (N,), envs=[env])[0]


class HeldNoise(Noise):
    """The same with ``warm_start=noise_hold``."""

    def __init__(self, seed, episodes):
        super().__init__(seed, episodes)
        self.hold, self.step = NoiseHold(self.source), 0

    def reset(self, envs):
        super().reset(envs)
        self.hold.reset(envs)

    def draw(self, env):
        self.step += 1
        return self.hold.draw(1, (N, 1), self.step, envs=[env])[0, :, 0]


class Codes:
    """`vqbet_chunked`'s draws."""

    def __init__(self, seed, episodes, held):
        hold_steps = math.inf if held else 0.0
        self.draws = HeldDraws(NoiseSource(seed, episodes), (N,), torch.rand, hold_steps=hold_steps)

    def reset(self, envs):
        self.draws.reset(envs)

    def draw(self, env):
        return self.draws.draw(1, envs=[env])[0, 0]


KINDS = {
    "noise": Noise,
    "held noise": HeldNoise,
    "codes": lambda *args: Codes(*args, held=False),
    "held codes": lambda *args: Codes(*args, held=True),
    **dict(of_every_type("STREAMS")),
}


class Run:
    """One policy's draws: every episode's first draw, by environment."""

    def __init__(self, kind: str, seed: int = 0):
        self.episodes = Episodes()
        self.kind = KINDS[kind](seed, self.episodes)
        self.first: dict[int, list[torch.Tensor]] = {env: [] for env in range(N_ENVS)}
        self.begun: set[int] = set()

    def reset(self, envs=None, seeds=None):
        self.episodes.begin(envs, seeds)
        self.kind.reset(envs)
        self.begun -= set(range(N_ENVS) if envs is None else envs)

    def act(self, env):
        drawn = self.kind.draw(env)
        if env not in self.begun:
            self.first[env].append(drawn)
            self.begun.add(env)
        return drawn


some_envs = st.none() | st.lists(st.integers(0, N_ENVS - 1), unique=True)
events = st.lists(
    st.tuples(st.just("reset"), some_envs) | st.tuples(st.just("act"), st.integers(0, N_ENVS - 1)),
    max_size=30,
)
kinds = st.sampled_from(sorted(KINDS))
property_test = settings(max_examples=draws(50, 5000), deadline=None)


def play(run: Run, story) -> list[torch.Tensor]:
    return [run.act(what) for event, what in story if event == "act" or run.reset(what)]


@property_test
@given(kinds, events, st.integers(0, 2**40))
def test_the_same_run_repeats_whatever_is_reset_before_it(kind, story, seed):
    once, again = Run(kind, seed), Run(kind, seed)
    for envs in (None, [1], None):
        again.reset(envs)
    for one, other in zip(play(once, story), play(again, story), strict=True):
        assert torch.equal(one, other)


@property_test
@given(kinds, events)
def test_no_two_episodes_share_their_draws(kind, story):
    run = Run(kind)
    play(run, story)
    firsts = [drawn for each in run.first.values() for drawn in each]
    assert all(not torch.equal(a, b) for a, b in itertools.combinations(firsts, 2))


@property_test
@given(kinds, events, st.integers(0, N_ENVS - 1))
def test_an_environments_episodes_do_not_depend_on_the_others(kind, story, env):
    together, alone = Run(kind), Run(kind)
    play(together, story)
    for event, what in story:
        if event == "act" and what == env:
            alone.act(env)
        elif event == "reset" and (what is None or env in what):
            alone.reset([env])
    if kind == "held noise":  # counts the steps of all
        assert len(together.first[env]) == len(alone.first[env])
        return
    for one, other in zip(together.first[env], alone.first[env], strict=True):
        assert torch.equal(one, other)


@property_test
@given(kinds, events, st.integers(0, 2**70), st.integers(0, N_ENVS - 1))
def test_an_episode_with_a_known_seed_depends_on_nothing_else(kind, story, episode_seed, env):
    if kind == "held noise":
        story = []
    after, fresh = Run(kind), Run(kind)
    play(after, story)
    after.reset([env], [episode_seed])
    fresh.reset(None, [episode_seed])
    for _ in range(3):
        assert torch.equal(after.act(env), fresh.act(0))
    after.reset([env])
    assert not torch.equal(after.act(env), fresh.first[0][0])


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_streams_are_uncorrelated(kind):
    """Over seeds, environments, episodes counted and known, and the streams of one policy."""
    rows = []
    for seed in (0, 1, 2**32, 2**32 + 1):
        run = Run(kind, seed)
        for episode in range(5):
            run.reset(None, [0, 1, 2, 2**32] if episode == 4 else None)
            rows += [run.act(env) for env in range(N_ENVS)]
    if kind in ("latents", "choices"):
        other = KINDS["choices" if kind == "latents" else "latents"](0, Episodes())
        rows += [
            torch.special.ndtri(other.draw(env)) if kind == "latents" else other.draw(env) for env in (0, 1)
        ]
    drawn = torch.stack(rows)
    assert len(drawn.unique(dim=0)) == len(rows)
    if drawn.shape[1] > 1:
        correlation = np.corrcoef(drawn.double())[np.triu_indices(len(rows), 1)]
        assert abs(correlation.mean()) < 4 / math.sqrt((N - 1) * len(correlation))


def test_latents_and_choices_never_meet():
    """Seeds that differ by a power of two once gave environments each other's streams."""
    raw = [
        Episodes().generator(seed, env, stream).initial_seed()
        for seed in (0, 1, 2**32, 2**33, 2**64)
        for env in range(50)
        for stream in (0, 1)
    ]
    assert len(set(raw)) == len(raw)


@pytest.mark.parametrize(
    ("envs", "seeds", "message"),
    [([0, 1], [3], "1 seeds for 2 environments"), (None, [3, -1], r"must not be negative: \[3, -1\]")],
)
def test_seeds_that_do_not_fit_are_refused(envs, seeds, message):
    episodes = Episodes()
    before = episodes.generator(0, 0).initial_seed()
    with pytest.raises(ValueError, match=message):
        episodes.begin(envs, seeds)
    assert episodes.generator(0, 0).initial_seed() == before
