"""Demonstrations of the three gates, and fake policies whose ways through them are known."""

from types import SimpleNamespace

import numpy as np
import torch

from lerobot_act_chunking.diagnostics.core.environments import EnvironmentSpec
from lerobot_act_chunking.diagnostics.core.rollouts import roll_out
from lerobot_act_chunking.diagnostics.modes.demonstrated import Demonstrated
from lerobot_act_chunking.diagnostics.modes.settings import Settings
from lerobot_act_chunking.envs.configuration_three_gates import ThreeGatesEnvConfig
from lerobot_act_chunking.envs.demonstration import ExpertOptions
from lerobot_act_chunking.envs.three_gates.expert import plan
from lerobot_act_chunking.policies.loading import LoadedPolicy

SHARES = (0.8, 0.15, 0.05)
CHUNK, REPLAN = 20, 4


def settings(**asked) -> Settings:
    return Settings("planted", EnvironmentSpec("three_gates"), **asked)


def of_shares(episodes, shares=SHARES):
    """A mode for each episode, exactly as often as told, in mixed order."""
    counts = np.round(np.array(shares) * episodes).astype(int)
    return np.random.default_rng(0).permutation(np.repeat(np.arange(len(shares)), counts))


def demonstrations(modes, noise=0.01, seed=1) -> Demonstrated:
    """What the expert does from random starts, in the given modes."""
    rng = np.random.default_rng(seed)
    motions = [
        plan(rng.uniform(-0.02, 0.02, 2), ExpertOptions(waypoint_noise=noise), rng, mode=int(mode))[0]
        for mode in modes
    ]
    unit = np.concatenate(motions).std(0)
    scaled = [each / unit for each in motions]
    return Demonstrated("planted", "recording", np.arange(len(modes)), scaled, np.asarray(modes), unit)


class Planted:
    """Goes in each episode the ways that a function of its number says, chunk by chunk.

    A way is a tuple of weights of the three gates: (1, 0, 0) the first, (0.5, 0.5, 0) between two.
    """

    name = "planted"

    def __init__(self, way, replan=CHUNK, first_seed=0):
        self.way, self.replan, self.first_seed = way, replan, first_seed
        self.config = SimpleNamespace(type="planted", execution="open_loop")

    def reset(self, episode_seeds):
        self.numbers = [seed - self.first_seed for seed in episode_seeds]
        self.step = -1

    def select_action(self, batch):
        self.step += 1
        if self.step % self.replan == 0:
            self.chunk = self.predict_action_chunk(batch)
        return self.chunk[:, self.step % self.replan]

    def predict_action_chunk(self, batch):
        starts, call = batch["observation.state"].numpy(), self.step // self.replan
        if call == 0:
            self.starts = starts
        return torch.from_numpy(np.stack([self._plan(i, call) for i in range(len(starts))]))

    def _plan(self, place, call):
        """The next actions of the expert's mean plan in the way of this call."""
        rng = np.random.default_rng(0)
        gates = [plan(self.starts[place], ExpertOptions(), rng, mode=mode)[0] for mode in range(3)]
        weights = self.way(self.numbers[place], call)
        mixed = sum(weight * gate for weight, gate in zip(weights, gates, strict=True))
        return mixed[np.minimum(np.arange(CHUNK) + self.step, len(mixed) - 1)]


def act(policy, episodes):
    """Episodes of a planted policy, and the policy with processors that change nothing."""
    loaded = LoadedPolicy(policy, lambda batch: batch, lambda actions: actions)
    env_config = ThreeGatesEnvConfig(obs_type="state")
    seeds = range(policy.first_seed, policy.first_seed + episodes)
    return loaded, roll_out(loaded, env_config, seeds, n_envs=episodes)


def one_hot(mode):
    return tuple(float(each == mode) for each in range(3))
