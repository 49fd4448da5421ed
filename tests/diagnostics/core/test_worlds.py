"""Environments that are not this package's are rolled out as by lerobot-eval, too."""

from dataclasses import dataclass, field

import gymnasium as gym
import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.processor import ObservationProcessorStep, PolicyProcessorPipeline
from lerobot.scripts.lerobot_eval import rollout as lerobot_rollout
from small_policies import make_policy

from lerobot_act_chunking.diagnostics.core.rollouts import roll_out
from lerobot_act_chunking.diagnostics.core.worlds import (
    check_sees_what_it_needs,
    make_env_config,
    open_worlds,
    succeeded,
)
from lerobot_act_chunking.errors import ConfigurationError, FeatureError

STATE = {"observation.state": PolicyFeature(FeatureType.STATE, (2,))}
SEEDS = (3, 1, 2)


class Line(gym.Env):
    """A point that commands move; success is to have gone past 0.2."""

    observation_space = gym.spaces.Dict({"agent_pos": gym.spaces.Box(-9, 9, (2,), np.float64)})
    action_space = gym.spaces.Box(-1, 1, (2,), np.float32)
    task = task_description = "go on"

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.position = self.np_random.uniform(-0.1, 0.1, 2)
        return {"agent_pos": self.position}, {}

    def step(self, action):
        self.position = self.position + 0.1 * action
        done = bool(self.position[0] > 0.2)
        return {"agent_pos": self.position}, float(self.position[0]), done, False, {"is_success": done}


class Doubled(ObservationProcessorStep):
    def observation(self, observation):
        return {**observation, "observation.state": 2 * observation["observation.state"]}

    def transform_features(self, features):
        return features


@EnvConfig.register_subclass("line_of_tests")
@dataclass
class LineConfig(EnvConfig):
    task: str | None = "Line-v0"
    fps: int = 10
    features: dict = field(
        default_factory=lambda: {
            "action": PolicyFeature(FeatureType.ACTION, (2,)),
            "agent_pos": PolicyFeature(FeatureType.STATE, (2,)),
        }
    )
    features_map: dict = field(
        default_factory=lambda: {"action": "action", "agent_pos": "observation.state"},
    )
    doubled: bool = False
    n_tasks: int = 1

    @property
    def gym_kwargs(self):
        return {"max_episode_steps": 12}

    def create_envs(self, n_envs, use_async_envs=False):
        (suite,) = super().create_envs(n_envs, use_async_envs).values()
        return {"line": dict.fromkeys(range(self.n_tasks), suite[0])}

    def get_env_processors(self):
        steps = [Doubled()] if self.doubled else []
        return PolicyProcessorPipeline(steps=steps), PolicyProcessorPipeline(steps=[])


gym.register("gym_line_of_tests/Line-v0", Line)


def policy(size=2):
    inputs = {"observation.state": PolicyFeature(FeatureType.STATE, (size,))}
    return make_policy(inputs=inputs, start=torch.tensor([0.4, 0.0]), n_action_steps=5)


@pytest.mark.parametrize("doubled", [False, True])
def test_other_environments_are_rolled_out_as_by_lerobot_eval(doubled):
    env_config, acting = make_env_config("line_of_tests", {"doubled": doubled}), policy()
    vector = env_config.create_envs(len(SEEDS))["line"][0]
    processors = (*env_config.get_env_processors(), acting.preprocessor, acting.postprocessor)
    theirs = lerobot_rollout(vector, acting.policy, *processors, seeds=list(SEEDS))
    ours = roll_out(acting, env_config, SEEDS)
    for i, rollout in enumerate(ours):
        steps = len(rollout.commands)
        np.testing.assert_array_equal(rollout.commands, theirs["action"][i, :steps].numpy())
        assert rollout.success == bool(theirs["success"][i, :steps].any())
        assert rollout.dt == 0.1
    assert {rollout.success for rollout in ours} == {True}


def test_groups_of_environments_begin_anew():
    env_config = make_env_config("line_of_tests", {})
    one_by_one = roll_out(policy(), env_config, SEEDS, n_envs=1)
    starts = [rollout.rewards[0] for rollout in one_by_one]
    together = [rollout.rewards[0] for rollout in roll_out(policy(), env_config, SEEDS)]
    assert len(set(starts)) == len(SEEDS)
    np.testing.assert_allclose(starts, together, atol=1e-5)


def test_suites_of_several_tasks_are_refused():
    with pytest.raises(ConfigurationError, match=r"has 2 tasks \(line 0, line 1\): choose one"):
        open_worlds(make_env_config("line_of_tests", {"n_tasks": 2}), 1, policy().policy.config)


@pytest.mark.parametrize(
    ("env_type", "arguments", "message"),
    [
        ("moon", {}, "unknown environment type 'moon'; choose one of: .*line_of_tests"),
        ("line_of_tests", {"gravity": 1.6}, "--env-arg of the environment line_of_tests: .*gravity"),
    ],
)
def test_unknown_environments_and_fields_are_refused(env_type, arguments, message):
    with pytest.raises(ConfigurationError, match=message):
        make_env_config(env_type, arguments)


def test_other_sizes_are_refused_unless_the_environment_changes_them():
    with pytest.raises(FeatureError, match=r"trained with 3 numbers of 'observation.state'"):
        check_sees_what_it_needs(policy(3).policy.config, make_env_config("line_of_tests", {}))
    renamed = make_env_config("line_of_tests", {"doubled": True})
    assert check_sees_what_it_needs(policy(3).policy.config, renamed) is None


@pytest.mark.parametrize(
    ("info", "success"),
    [({}, False), ({"is_success": np.True_}, True), ({"final_info": {"is_success": True}}, True)],
)
def test_where_success_is_said(info, success):
    assert succeeded(info) is success
