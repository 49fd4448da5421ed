"""What an environment must show follows from what a policy saw, unless it is given."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tiers import draws

from lerobot_act_chunking.envs.configuration_envs import AlohaSimEnvConfig
from lerobot_act_chunking.envs.configuration_robotics import RoboticsEnvConfig
from lerobot_act_chunking.errors import ConfigurationError

IMAGES = {"observation.images.top": (3, 60, 80), "observation.images.angle": (3, 60, 80)}
TWO_SIZES = IMAGES | {"observation.images.angle": (3, 30, 40)}


class Features:
    """The part of a policy configuration that decides which environment it needs."""

    def __init__(self, images: dict[str, tuple[int, ...]], **vectors: int):
        self.image_features = {key: Shape(shape) for key, shape in images.items()}
        sizes = {f"observation.{name}": Shape((size,)) for name, size in vectors.items()}
        self.input_features = {**self.image_features, **sizes}


class Shape:
    def __init__(self, shape):
        self.shape = shape


def aloha(policy, **given_options):
    return AlohaSimEnvConfig(**AlohaSimEnvConfig.options_for(policy, given_options))


def test_vectors():
    state = aloha(Features({}, state=14, environment_state=7), task="insertion", success="hold")
    assert state == AlohaSimEnvConfig(
        task="insertion", success="hold", obs_type="state", agent_vel=False, render_quality="fast"
    )
    assert aloha(Features({}, agent_vel=14)).agent_vel


def test_images():
    seeing = aloha(Features(IMAGES, state=14))
    assert (seeing.obs_type, seeing.cameras, seeing.agent_vel) == ("pixels_state", ["top", "angle"], False)
    assert (seeing.observation_height, seeing.observation_width) == (60, 80)
    assert aloha(Features(IMAGES)).obs_type == "pixels"
    moving = aloha(Features(IMAGES, agent_vel=14))
    assert (moving.obs_type, moving.agent_vel) == ("pixels_state", True)


@pytest.mark.parametrize(
    ("task", "vectors", "velocities"),
    [
        ("FetchPush-v4", {"state": 10, "environment_state": 18}, True),
        ("FetchPush-v4", {"state": 5, "environment_state": 12}, False),
        ("AdroitHandHammer-v1", {"state": 29, "environment_state": 17}, True),
        ("AdroitHandHammer-v1", {"state": 29, "environment_state": 11}, False),
    ],
)
def test_robotics_worlds_show_velocities_to_policies_that_saw_them(task, vectors, velocities):
    policy = Features({}, **vectors)
    config = RoboticsEnvConfig(**RoboticsEnvConfig.options_for(policy, {"task": task, "success": "final"}))
    assert (config.task, config.success, config.velocities) == (task, "final", velocities)
    assert config.features["environment_state"].shape == (vectors["environment_state"],)


def test_the_default_task_decides_where_none_is_given():
    size = {True: 10, False: 5}
    for velocities, numbers in size.items():
        found = RoboticsEnvConfig.options_for(Features({}, state=numbers), {})
        assert found["velocities"] is velocities


@settings(max_examples=draws(50, 500), deadline=None)
@given(
    st.fixed_dictionaries(
        {},
        optional={
            "obs_type": st.sampled_from(["state", "pixels", "pixels_state"]),
            "cameras": st.lists(st.sampled_from(["top", "angle"]), unique=True),
            "observation_height": st.integers(1, 99),
            "observation_width": st.integers(1, 99),
            "render_quality": st.sampled_from(["full", "fast"]),
            "agent_vel": st.booleans(),
        },
    ),
    st.sampled_from([{}, IMAGES]),
)
def test_what_is_given_wins(options, images):
    policy = Features(images, state=14)
    found = AlohaSimEnvConfig.options_for(policy, options)
    alone = AlohaSimEnvConfig.options_for(policy, {})
    assert found == {**alone, **options}


def test_cameras_of_two_sizes_need_one_that_is_given():
    with pytest.raises(
        ConfigurationError, match=r"one image size, the policy wants \[\(30, 40\), \(60, 80\)\]"
    ):
        aloha(Features(TWO_SIZES), observation_height=60)
    both = aloha(Features(TWO_SIZES), observation_height=50, observation_width=70)
    assert (both.observation_height, both.observation_width) == (50, 70)
