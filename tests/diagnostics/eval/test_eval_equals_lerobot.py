"""`act-chunking eval` finds what `lerobot-eval` finds, episode by episode, bit for bit on a CPU."""

from importlib.util import find_spec

import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.envs.factory import make_env, make_env_pre_post_processors
from lerobot.scripts.lerobot_eval import eval_policy
from small_policies import CAMERA, START, STATE, make_policy, save
from tiers import full_tier

from lerobot_act_chunking.diagnostics.core.environments import EnvironmentSpec, environment_of
from lerobot_act_chunking.diagnostics.core.recipes import Recipe
from lerobot_act_chunking.diagnostics.eval.diagnosis import diagnose
from lerobot_act_chunking.diagnostics.eval.settings import Settings
from lerobot_act_chunking.envs.configuration_simulation import SimulationEnvConfig
from lerobot_act_chunking.policies.loading import load_policy

EPISODES, BATCH = 5, 3
pytestmark = pytest.mark.filterwarnings("ignore")  # of simulators


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


TASKS = {
    f"{env_type} {task}": EnvironmentSpec(env_type, {"task": task, "episode_length": 12})
    for env_type, config in sorted(EnvConfig.get_known_choices().items())
    if issubclass(config, SimulationEnvConfig) and config.__module__.startswith("lerobot_act_chunking.")
    for task in config.task_names
}
"""All of this package's."""
OTHERS = {
    "aloha": ("gym_aloha", {"episode_length": 4}, None),
    "so101": ("lerobot_env_so101", {"random_block_position": True, "episode_length": 12}, "succeed"),
}
"""LeRobot's own and a plug-in's: the module that they need, their fields, and what they call success."""


def by_lerobot(checkpoint, spec):
    """What lerobot-eval's own function says of the episodes, and of their steps."""
    policy = load_policy(checkpoint)
    env_config = environment_of(policy.policy.config, spec, checkpoint)
    processors = make_env_pre_post_processors(env_config, policy.policy.config)
    ((env,),) = (each.values() for each in make_env(env_config, n_envs=BATCH).values())
    found = eval_policy(
        env,
        policy.policy,
        *processors,
        policy.preprocessor,
        policy.postprocessor,
        n_episodes=EPISODES,
        start_seed=1000,
        return_episode_data=True,
    )
    env.close()
    return found["per_episode"], found["episodes"]


def by_both(checkpoint, spec, folder):
    """Episodes by `act-chunking eval`, and what `lerobot-eval` says of them; all commands are the same."""
    recipes = (Recipe("p", (checkpoint,)),)
    (result,) = diagnose(Settings(recipes, spec, EPISODES, batch_size=BATCH, output_dir=folder)).results
    theirs, steps = by_lerobot(checkpoint, spec)
    for place, each in enumerate(result.episodes):
        commands = steps["action"][steps["episode_index"] == place][: each.length].numpy()
        np.testing.assert_array_equal(result.commands(place), commands.astype(np.float32))
    return result.episodes, theirs


def check_same(ours, theirs, *, judged=True):
    """Successes, where the environment says them as LeRobot asks, and rewards."""
    if judged:
        assert [each.success for each in ours] == [each["success"] for each in theirs]
    for place, each in enumerate(ours):
        first = BATCH * (place // BATCH)
        # LeRobot counts the reward of one step more, where others of the batch are still acting.
        if each.length == max(other.length for other in ours[first : first + BATCH]):
            assert each.max_reward == theirs[place]["max_reward"]
            assert each.sum_reward == pytest.approx(theirs[place]["sum_reward"], rel=1e-12)


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
    ours, theirs = by_both(checkpoint, spec, tmp_path / "out")
    check_same(ours, theirs)


def observing(spec, folder, type_):
    """An untrained policy that observes what the environment shows by default."""
    config = EnvConfig.get_choice_class(spec.type)(**spec.options())
    shown = {config.features_map[key]: feature for key, feature in config.features.items()}
    images = {key for key, feature in shown.items() if feature.type is FeatureType.VISUAL}
    shown |= {key: PolicyFeature(FeatureType.VISUAL, (3, *shown[key].shape[:2])) for key in images}
    start = torch.zeros(shown.pop("action").shape)
    small = {"n_action_steps": 5, "dropout": 0.0}
    if images:
        small |= {"pretrained_backbone_weights": None} if type_ == "act" else {"vision_backbone": "small_cnn"}
    return save(make_policy(type_, inputs=shown, start=start, **small), folder)


@full_tier
@pytest.mark.parametrize("type_", ["act", "act_chunked"])
@pytest.mark.parametrize("task", TASKS)
def test_the_same_episodes_in_every_task_of_ours(task, type_, tmp_path):
    spec = TASKS[task]
    ours, theirs = by_both(observing(spec, tmp_path / "policy", type_), spec, tmp_path / "out")
    check_same(ours, theirs)


@full_tier
@pytest.mark.parametrize("type_", ["act", "act_chunked"])
@pytest.mark.parametrize("env_type", OTHERS)
def test_the_same_episodes_in_those_of_others(env_type, type_, tmp_path):
    module, arguments, key = OTHERS[env_type]
    pytest.importorskip(module)
    spec = EnvironmentSpec(env_type, arguments, success_key=key)
    ours, theirs = by_both(observing(spec, tmp_path / "policy", type_), spec, tmp_path / "out")
    check_same(ours, theirs, judged=key is None)


@pytest.mark.slow
def test_where_no_success_is_said_lerobot_calls_every_end_one(tmp_path):
    """What docs/instruments/eval.md says of it; here nothing is known then."""
    inputs = {"observation.state": vector(2)}
    checkpoint = save(make_policy(inputs=inputs, start=torch.zeros(2)), tmp_path / "policy")
    arguments = {"key": "succeed", "ends": {"success": 9}}
    spec = EnvironmentSpec("line_of_tests", arguments, ("line_environment",))
    ours, theirs = by_both(checkpoint, spec, tmp_path / "out")
    assert [each["success"] for each in theirs] == [True] * EPISODES
    assert [(each.success, each.instead) for each in ours] == [(False, ["succeed"])] * EPISODES
