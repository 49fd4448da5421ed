"""Evaluations whose answers are known: demonstrations replayed, an expert, a robot that stands still."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from small_policies import STATE

from lerobot_act_chunking.diagnostics.core.environments import EnvironmentSpec, action_names, environment_of
from lerobot_act_chunking.diagnostics.core.recipes import Recipe
from lerobot_act_chunking.diagnostics.eval import diagnosis, playing
from lerobot_act_chunking.diagnostics.eval.diagnosis import diagnose
from lerobot_act_chunking.diagnostics.eval.settings import Settings
from lerobot_act_chunking.diagnostics.eval.subject import Subject
from lerobot_act_chunking.envs.aloha.env import AlohaSimEnv
from lerobot_act_chunking.envs.aloha.experts import plan
from lerobot_act_chunking.envs.aloha.tasks import get_task
from lerobot_act_chunking.envs.operators import OPERATORS
from lerobot_act_chunking.policies.loading import LoadedPolicy
from lerobot_act_chunking.recording.aloha import AlohaSource
from lerobot_act_chunking.recording.spec import RecordSpec

pytestmark = pytest.mark.slow
SEEDS = range(1000, 1008)


class Scripted:
    """Does in each episode what a function of its seed, its first observation and the step says."""

    name = "scripted"

    def __init__(self, command, task):
        self.command = command
        poses = PolicyFeature(FeatureType.ENV, (get_task(task).pose_size,))
        self.config = SimpleNamespace(
            type="scripted",
            input_features={**STATE, "observation.environment_state": poses},
            image_features={},
            action_feature=SimpleNamespace(shape=(14,)),
        )

    def reset(self, episode_seeds):
        self.seeds, self.step, self.first = list(episode_seeds), -1, None

    def select_action(self, batch):
        state = batch["observation.state"], batch["observation.environment_state"]
        self.first = self.first or [tuple(each[i].numpy() for each in state) for i in range(len(self.seeds))]
        self.step += 1
        commands = [self.command(*each, self.step) for each in zip(self.seeds, self.first, strict=True)]
        return torch.from_numpy(np.stack(commands))

    def predict_action_chunk(self, batch):
        raise NotImplementedError


@pytest.fixture
def evaluate(monkeypatch, tmp_path):
    """Evaluates a function as if it were a checkpoint."""

    def evaluate(command, task, rule="touch"):
        policy = Scripted(command, task)
        spec = EnvironmentSpec("aloha_sim", {"task": task, "success": rule})
        env_config = environment_of(policy.config, spec)
        subject = Subject("scripted", policy.config, env_config, action_names(env_config, 14, "scripted"))
        monkeypatch.setattr(diagnosis, "read_subject", lambda *_: subject)
        monkeypatch.setattr(diagnosis, "checkpoint_digest", str)
        monkeypatch.setattr(playing, "load_policy", lambda _: LoadedPolicy(policy, dict, lambda each: each))
        recipes = (Recipe("scripted", ("scripted",)),)
        return diagnose(Settings(recipes, spec, len(SEEDS), SEEDS[0], 4, output_dir=tmp_path)).results[0]

    return evaluate


def expert_commands(task, options_of):
    """The commands of the scripted expert, planned from the first observation of each episode."""
    plans = {}

    def command(seed, first, step):
        if seed not in plans:
            plans[seed] = plan(task, first[1].astype(float), options_of(seed), np.random.default_rng(seed))
        commands = plans[seed].commands
        return np.array(commands[min(step, len(commands) - 1)], np.float32)

    return command, plans


@pytest.mark.parametrize("task", ["transfer_cube", "insertion"])
def test_an_expert_has_its_own_rate(task, evaluate):
    clumsy = OPERATORS["clumsy"]

    def options_of(seed):
        options = clumsy.episode(np.random.default_rng(seed), AlohaSource.ranges)
        return options if seed % 2 else options.__class__()

    command, plans = expert_commands(task, options_of)
    result = evaluate(command, task)
    env = AlohaSimEnv(render_mode=None, task=task, obs_type="state")
    for episode in result.episodes:
        env.reset(seed=episode.seed)
        commands = [np.asarray(each, np.float32) for each in plans[episode.seed].commands]
        padded = commands + [commands[-1]] * (400 - len(commands))
        own = next((i for i, each in enumerate(padded) if env.step(each)[4]["is_success"]), None)
        assert episode.success == (own is not None)
        assert episode.length == (400 if own is None else own + 1)
    assert result.rate.successes > 0


def test_recorded_demonstrations_have_their_recorded_successes(evaluate):
    source = RecordSpec(task="transfer_cube", episodes=len(SEEDS), repo_id="me/demonstrations").source()
    with source.open() as play:
        recorded = {seed: play(seed) for seed in SEEDS}

    def command(seed, first, step):
        actions = recorded[seed].arrays["action"]
        return actions[min(step, len(actions) - 1)]

    result = evaluate(command, "transfer_cube", rule="hold")
    assert {each.seed: each.success for each in result.episodes} == {
        seed: episode.success for seed, episode in recorded.items()
    }
    assert result.rate.successes > 0


@pytest.mark.parametrize("task", ["transfer_cube", "insertion"])
def test_who_stands_still_never_succeeds(task, evaluate):
    result = evaluate(lambda seed, first, step: first[0], task)
    assert result.rate.successes == 0
    assert result.failures == {"no contact": len(SEEDS)}
    assert result.stalled == len(SEEDS)
