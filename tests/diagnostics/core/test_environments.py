"""Any environment that LeRobot can make, as it is asked for, with what a policy needs to see."""

import json
import logging
from dataclasses import dataclass

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from line_environment import Ends, LineConfig
from small_policies import CAMERA, make_policy, save
from tiers import draws

from lerobot_act_chunking.diagnostics.core.environments import (
    EnvironmentSpec,
    action_names,
    environment_of,
    task_environment,
)
from lerobot_act_chunking.envs.aloha.tasks import JOINT_NAMES
from lerobot_act_chunking.envs.configuration_envs import AlohaSimEnvConfig
from lerobot_act_chunking.envs.configuration_robotics import RoboticsEnvConfig
from lerobot_act_chunking.envs.configuration_simulation import SimulationEnvConfig
from lerobot_act_chunking.errors import ConfigurationError, FeatureError

LINE = "line_of_tests"


def config(size=2, **settings):
    inputs = {"observation.state": PolicyFeature(FeatureType.STATE, (size,))}
    return make_policy(inputs=inputs, start=torch.tensor([0.4, 0.0]), **settings).policy.config


@settings(max_examples=draws(20, 200), deadline=None)
@given(width=st.integers(2, 9), end=st.floats(-9, 9), doubled=st.booleans())
def test_other_environments_are_as_they_are_asked_for(width, end, doubled):
    asked = EnvironmentSpec(LINE, {"width": width, "ends": {"success": end}, "doubled": doubled})
    assert environment_of(CONFIGS[width], asked) == LineConfig(width=width, ends=Ends(end), doubled=doubled)


CONFIGS = {size: config(size) for size in range(2, 10)}


def test_those_of_this_package_show_what_the_policy_saw_unless_it_is_given():
    seeing = make_policy(inputs=CAMERA, vision_backbone="small_cnn").policy.config
    asked = {"task": "insertion", "success": "hold", "episode_length": 9}
    made = environment_of(seeing, EnvironmentSpec("aloha_sim", asked))
    assert made == AlohaSimEnvConfig(
        obs_type="pixels", observation_height=48, observation_width=64, render_quality="fast", **asked
    )
    otherwise = {**asked, "obs_type": "pixels_state", "observation_width": 80, "render_quality": "full"}
    made = environment_of(seeing, EnvironmentSpec("aloha_sim", otherwise))
    assert made == AlohaSimEnvConfig(observation_height=48, **otherwise)


def test_short_names_are_those_of_the_tasks_of_this_package():
    cube, push = task_environment("transfer_cube"), task_environment("FetchPush-v4", "final")
    assert cube == EnvironmentSpec("aloha_sim", {"task": "transfer_cube"})
    assert push == EnvironmentSpec("gymnasium_robotics", {"task": "FetchPush-v4", "success": "final"})
    for config_class in (AlohaSimEnvConfig, RoboticsEnvConfig):
        for task in config_class.task_names[:: len(config_class.task_names) - 1]:
            asked = task_environment(task)
            assert (EnvConfig.get_choice_class(asked.type), asked.name) == (config_class, task)
    with pytest.raises(
        ConfigurationError, match=r"unknown task 'Line-v0'; choose one of: transfer_cube, .*--env\.type"
    ):
        task_environment("Line-v0")


@EnvConfig.register_subclass("dot_of_tests")
@dataclass
class DotConfig(SimulationEnvConfig):
    """Somebody else's, on the base class of this package."""

    task_names = ("Dot-v0",)
    task: str = "Dot-v0"
    gym_id, gym_kwargs = "own/Dot-v0", {}

    def __post_init__(self):
        self.check_observations(cameras=("top",))
        self.declare_features(2, {"agent_pos": 2}, 3)


def test_other_peoples_tasks_have_short_names_too():
    asked = task_environment("Dot-v0")
    assert asked == EnvironmentSpec("dot_of_tests", {"task": "Dot-v0"})
    images = {"observation.images.top": PolicyFeature(FeatureType.VISUAL, (3, 30, 40))}
    seeing = make_policy(inputs=images, start=torch.zeros(2), vision_backbone="small_cnn").policy.config
    made = environment_of(seeing, asked)
    assert (made.obs_type, made.cameras, made.render_quality) == ("pixels", ["top"], "fast")


def test_reports_call_an_environment_by_its_task_or_its_type():
    assert EnvironmentSpec(LINE).name == LINE
    assert EnvironmentSpec(LINE, {"task": "Line-v0"}).name == "Line-v0"


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (
            ("moon",),
            r"unknown environment type 'moon'; choose one of: .*line_of_tests.*discover_packages_path",
        ),
        ((LINE, {"witdh": 3}), r"has no --env\.witdh; did you mean --env\.width\? It has: task, fps, "),
        ((LINE, {"gravity": 1.6}), r"line_of_tests has no --env\.gravity\. It has: task, fps, "),
        ((LINE, {"width": "wide"}), r"--env\.width of line_of_tests does not take 'wide': .*into an int"),
        ((LINE, {"ends": {"succes": 1}}), r"--env\.ends of line_of_tests does not take .*succes.* not valid"),
        ((LINE, {"ends": {"success": "far"}}), r"--env\.ends .*`success`: Couldn't parse 'far' into a"),
        (("aloha_sim", {"cameras": "top"}), r"--env\.cameras of aloha_sim does not take 'top': .* list"),
        ((LINE, {}, ("no_such_package",)), r"discover_packages_path=no_such_package cannot be imported"),
        ((LINE, {}, ("small_policies",)), r"discover_packages_path=small_policies .*needs __path__ = \[\]"),
    ],
)
def test_what_no_environment_takes_is_refused_at_once(asked, message):
    with pytest.raises(ConfigurationError, match=message):
        EnvironmentSpec(*asked)


def test_what_an_environment_itself_refuses_is_one_error():
    with pytest.raises(
        ConfigurationError, match="line_of_tests refuses its --env options: a line of width 1"
    ):
        environment_of(config(), EnvironmentSpec(LINE, {"width": 1}))
    with pytest.raises(ConfigurationError, match="unknown task 'juggle'; choose one of: transfer_cube"):
        environment_of(config(), EnvironmentSpec("aloha_sim", {"task": "juggle"}))


def test_other_sizes_are_refused_unless_the_environment_changes_them():
    with pytest.raises(FeatureError, match=r"trained with 3 numbers of 'observation.state', the environment"):
        environment_of(config(3), EnvironmentSpec(LINE))
    assert environment_of(config(3), EnvironmentSpec(LINE, {"doubled": True})).width == 2


def test_another_rate_is_refused_where_it_is_known_and_said_elsewhere(caplog):
    with caplog.at_level(logging.WARNING):
        environment_of(config(fps=10), EnvironmentSpec(LINE))
    assert not caplog.messages
    with caplog.at_level(logging.WARNING):
        assert environment_of(config(fps=30), EnvironmentSpec(LINE)).fps == 10
    assert "trained at 30 control steps a second, the environment line_of_tests runs at 10" in caplog.text
    with pytest.raises(FeatureError, match="trained at 30 control steps a second"):
        environment_of(make_policy(fps=30).policy.config, task_environment("transfer_cube"))


def test_actions_are_called_as_in_the_environment_or_in_the_training_data(tmp_path):
    checkpoint = save(make_policy(), tmp_path / "policy")
    assert action_names(AlohaSimEnvConfig(), 14, checkpoint) == JOINT_NAMES
    assert action_names(LineConfig(), 2, checkpoint) == ("action_0", "action_1")
    (tmp_path / "data" / "meta").mkdir(parents=True)
    action = {"dtype": "float32", "shape": [2], "names": ["reach", "gripper"]}
    (tmp_path / "data" / "meta" / "info.json").write_text(json.dumps({"features": {"action": action}}))
    training = {"dataset": {"root": str(tmp_path / "data"), "repo_id": "me/data"}}
    (tmp_path / "policy" / "train_config.json").write_text(json.dumps(training))
    assert action_names(LineConfig(), 2, checkpoint) == ("reach", "gripper")
    assert action_names(LineConfig(), 3, checkpoint) == ("action_0", "action_1", "action_2")
