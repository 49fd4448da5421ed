"""The engines behind ``lerobot-rollout``, driving `act_chunked` on a robot without hardware."""

import pytest
import torch
from fake_robot import JOINTS, FakeRobot
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.factory import make_pre_post_processors
from lerobot.rollout.inference.factory import SyncInferenceConfig, create_inference_engine
from lerobot.rollout.inference.rtc import supports_rtc_inference
from lerobot.rollout.robot_wrapper import ThreadSafeRobot
from lerobot.utils.feature_utils import build_dataset_frame, hw_to_dataset_features
from policy_cases import SIZES

from lerobot_act_chunking.policies.act_chunked.configuration_act_chunked import ActChunkedConfig
from lerobot_act_chunking.policies.act_chunked.modeling_act_chunked import ActChunkedPolicy

START, MEAN, STD, FPS = 3.5, 3.0, 2.0, 50
N_STEPS = 12
SHAPE = (len(JOINTS),)
FEATURES = hw_to_dataset_features(FakeRobot.observation_features, "observation") | hw_to_dataset_features(
    FakeRobot.action_features, "action"
)
STATS = {
    key: {"mean": torch.full(SHAPE, MEAN), "std": torch.full(SHAPE, STD)}
    for key in ("action", "observation.state")
}
SETTINGS = {
    "crossfade": {"execution": "crossfade"},
    "ensemble": {"execution": "ensemble", "replan_interval": 1},
    "history": {"n_obs_steps": 3, "use_velocity": True, "execution": "receding"},
    "sampled": {
        "decoder_type": "autoregressive",
        "action_likelihood": "gmm",
        "action_temperature": 1.0,
        "use_vae": True,
        "z_inference": "sample",
    },
}


def make_policy(**settings):
    torch.manual_seed(0)
    config = ActChunkedConfig(
        input_features={"observation.state": PolicyFeature(FeatureType.STATE, SHAPE)},
        output_features={"action": PolicyFeature(FeatureType.ACTION, SHAPE)},
        device="cpu",
        push_to_hub=False,
        **{**SIZES["act_chunked"], "chunk_size": 8, **settings},
    )
    return ActChunkedPolicy(config).eval()


def make_engine(policy, robot):
    preprocessor, postprocessor = make_pre_post_processors(policy.config, dataset_stats=STATS)
    return create_inference_engine(
        SyncInferenceConfig(),
        policy=policy,
        preprocessor=preprocessor,
        postprocessor=postprocessor,
        robot_wrapper=ThreadSafeRobot(robot),
        hw_features=FEATURES,
        dataset_features=FEATURES,
        ordered_action_keys=list(JOINTS),
        task="",
        fps=FPS,
        device="cpu",
    )


def roll_out(engine, robot):
    """What the robot did in one episode."""
    engine.reset()
    robot.__init__(START)
    for _ in range(N_STEPS):
        action = engine.get_action(build_dataset_frame(FEATURES, robot.get_observation(), "observation"))
        robot.send_action(dict(zip(JOINTS, action.tolist(), strict=True)))
    return torch.stack(robot.actions)


def by_hand(policy):
    """The same episode in normalised units, without LeRobot's processors."""
    policy.reset()
    state, actions = torch.full((1, *SHAPE), START), []
    for _ in range(N_STEPS):
        state = policy.select_action({"observation.state": (state - MEAN) / STD}) * STD + MEAN
        actions.append(state[0])
    return torch.stack(actions)


@pytest.mark.parametrize("name", SETTINGS)
def test_the_engine_drives_the_policy_and_begins_anew(name):
    policy, robot = make_policy(**SETTINGS[name]), FakeRobot(START)
    engine = make_engine(policy, robot)
    engine.start()
    first, second = roll_out(engine, robot), roll_out(engine, robot)
    assert torch.equal(second, first) is not policy.config.is_stochastic  # what samples draws anew
    engine.stop()
    fresh = make_policy(**SETTINGS[name])
    for episode in (first, second):
        torch.testing.assert_close(episode, by_hand(fresh), rtol=1e-4, atol=1e-4)
    assert first.std(0).min() > 0


def test_it_acts_in_the_real_time_engine_with_and_without_a_learned_prefix():
    assert supports_rtc_inference(make_policy())
    assert supports_rtc_inference(make_policy(prefix_steps=2))
