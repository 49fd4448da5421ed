"""Environments that are not this package's are rolled out as by lerobot-eval, too."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.scripts.lerobot_eval import rollout as lerobot_rollout
from line_environment import STEPS, Ends, Line, LineConfig
from small_policies import make_policy

from lerobot_act_chunking.diagnostics.core.rollouts import roll_out
from lerobot_act_chunking.diagnostics.core.worlds import failure_of, open_worlds, succeeded
from lerobot_act_chunking.errors import ConfigurationError

SEEDS = (3, 1, 2)


def policy():
    inputs = {"observation.state": PolicyFeature(FeatureType.STATE, (2,))}
    return make_policy(inputs=inputs, start=torch.tensor([0.4, 0.0]), n_action_steps=5)


@pytest.mark.parametrize("doubled", [False, True])
def test_other_environments_are_rolled_out_as_by_lerobot_eval(doubled):
    env_config, acting = LineConfig(doubled=doubled), policy()
    vector = env_config.create_envs(len(SEEDS))["line"][0]
    processors = (*env_config.get_env_processors(), acting.preprocessor, acting.postprocessor)
    theirs = lerobot_rollout(vector, acting.policy, *processors, seeds=list(SEEDS))
    ours = roll_out(acting, env_config, SEEDS)
    for i, rollout in enumerate(ours):
        steps = len(rollout.commands)
        np.testing.assert_array_equal(rollout.commands, theirs["action"][i, :steps].numpy())
        assert rollout.success == bool(theirs["success"][i, :steps].any())
        assert rollout.dt == 0.1
        assert rollout.positions.shape == (steps, 0)
    assert {rollout.success for rollout in ours} == {True}


def test_an_episode_ends_where_its_environment_cuts_it():
    assert [len(each.commands) for each in roll_out(policy(), LineConfig(ends=Ends(9)), SEEDS)] == [STEPS] * 3
    with pytest.raises(ConfigurationError, match="line_of_tests does not say how long an episode is"):
        roll_out(policy(), LineConfig(limited=False), SEEDS)


def test_groups_of_environments_begin_anew():
    env_config = LineConfig()
    one_by_one = roll_out(policy(), env_config, SEEDS, n_envs=1)
    starts = [rollout.rewards[0] for rollout in one_by_one]
    together = [rollout.rewards[0] for rollout in roll_out(policy(), env_config, SEEDS)]
    assert len(set(starts)) == len(SEEDS)
    np.testing.assert_allclose(starts, together, atol=1e-5)


def test_suites_of_several_tasks_are_refused():
    with pytest.raises(ConfigurationError, match=r"has 2 tasks \(line 0, line 1\): choose one"):
        open_worlds(LineConfig(n_tasks=2), 1, policy().policy.config)


def test_what_lerobot_cannot_make_is_one_error():
    with pytest.raises(
        ConfigurationError, match=r"cannot make .* line_of_tests \(ModuleNotFoundError: .*gym_line"
    ):
        open_worlds(LineConfig(task="Circle-v0"), 1, policy().policy.config)


@pytest.mark.parametrize(
    ("info", "success"),
    [({}, False), ({"is_success": np.True_}, True), ({"final_info": {"is_success": True}}, True)],
)
def test_where_success_is_said(info, success):
    assert succeeded(info) is success


def test_any_environment_with_an_attribute_tells_how_it_failed():
    env = Line()
    wrapped = gym.wrappers.TimeLimit(env, STEPS)
    assert failure_of(wrapped) is failure_of(env) is None, "it cannot tell"
    env.failure = "turned round"
    assert failure_of(wrapped) == failure_of(env) == "turned round"
    env.failure = None
    assert failure_of(wrapped) is None, "it has succeeded"


def test_a_rollout_has_what_its_environment_said_in_the_end(monkeypatch):
    monkeypatch.setattr(Line, "failure", property(lambda env: f"at {env.position[0]:.2f}"), raising=False)
    short, long = (roll_out(policy(), LineConfig(ends=Ends(end)), SEEDS[:1])[0] for end in (9, 0.2))
    assert short.failure == f"at {short.rewards[-1]:.2f}"
    assert (long.success, long.failure) == (True, None)
