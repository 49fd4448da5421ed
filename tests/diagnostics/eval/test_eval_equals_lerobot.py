"""`act-chunking eval` finds what `lerobot-eval` finds, episode by episode, bit for bit on a CPU."""

from importlib.util import find_spec

import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.factory import make_env, make_env_pre_post_processors
from lerobot.scripts.lerobot_eval import eval_policy_all
from small_policies import CAMERA, START, STATE, make_policy, save

from lerobot_act_chunking.diagnostics.core.environments import EnvironmentSpec, environment_of
from lerobot_act_chunking.diagnostics.core.recipes import Recipe
from lerobot_act_chunking.diagnostics.eval.diagnosis import diagnose
from lerobot_act_chunking.diagnostics.eval.settings import Settings
from lerobot_act_chunking.policies.loading import load_policy

EPISODES, BATCH = 5, 3


def vector(size, kind=FeatureType.STATE):
    return PolicyFeature(kind, (size,))


CASES = {
    "aloha_sim": (
        STATE,
        START,
        EnvironmentSpec("aloha_sim", {"task": "transfer_cube", "episode_length": 20}),
    ),
    "aloha_sim from a camera": (
        {**CAMERA, "observation.state": STATE["observation.state"]},
        START,
        EnvironmentSpec("aloha_sim", {"task": "insertion", "episode_length": 9}),
    ),
    "gymnasium_robotics": (
        {"observation.state": vector(10), "observation.environment_state": vector(18, FeatureType.ENV)},
        torch.tensor([0.5, -0.3, 0.2, 0.0]),
        EnvironmentSpec("gymnasium_robotics", {"task": "FetchPush-v4", "episode_length": 12}),
    ),
    "somebody else's": (
        {"observation.state": vector(2)},
        torch.tensor([0.4, 0.0]),
        EnvironmentSpec("line_of_tests", packages=("line_environment",)),
    ),
    "pusht": (
        {"observation.state": vector(2), "observation.environment_state": vector(16, FeatureType.ENV)},
        torch.tensor([250.0, 250.0]),
        None,
    ),
}


def by_lerobot(checkpoint, spec):
    """Successes and rewards of each episode, from lerobot-eval's own function."""
    policy = load_policy(checkpoint)
    env_config = environment_of(policy.policy.config, spec, checkpoint)
    processors = make_env_pre_post_processors(env_config, policy.policy.config)
    found = eval_policy_all(
        make_env(env_config, n_envs=BATCH),
        policy.policy,
        *processors,
        policy.preprocessor,
        policy.postprocessor,
        n_episodes=EPISODES,
        start_seed=1000,
    )
    return found["per_task"][0]["metrics"]


@pytest.mark.slow
@pytest.mark.parametrize("type_", ["act", "act_chunked"])
@pytest.mark.parametrize("case", CASES)
def test_the_same_episodes(case, type_, tmp_path):
    inputs, start, spec = CASES[case]
    if spec is None:
        if find_spec("gym_pusht") is None:
            pytest.skip("gym-pusht is not installed")
        spec = EnvironmentSpec("pusht", {"obs_type": "environment_state_agent_pos", "episode_length": 9})
    if type_ == "act" and not {"observation.environment_state", *CAMERA} & inputs.keys():
        pytest.skip("LeRobot's act observes more than a state")
    cameras = {"act": {"pretrained_backbone_weights": None}, "act_chunked": {"vision_backbone": "small_cnn"}}
    small = {"n_action_steps": 5, "dropout": 0.0} | (cameras[type_] if CAMERA.keys() <= inputs.keys() else {})
    checkpoint = save(make_policy(type_, inputs=inputs, start=start, **small), tmp_path / "policy")
    recipes = (Recipe("p", (checkpoint,)),)
    report = diagnose(Settings(recipes, spec, EPISODES, batch_size=BATCH, output_dir=tmp_path / "out"))
    ours, theirs = report.results[0].episodes, by_lerobot(checkpoint, spec)
    assert [each.success for each in ours] == theirs["successes"]
    for place, each in enumerate(ours):
        first = BATCH * (place // BATCH)
        # LeRobot counts the reward of one step more, where others of the batch are still acting.
        if each.length == max(other.length for other in ours[first : first + BATCH]):
            assert each.max_reward == theirs["max_rewards"][place]
            assert each.sum_reward == pytest.approx(theirs["sum_rewards"][place], rel=1e-12)
