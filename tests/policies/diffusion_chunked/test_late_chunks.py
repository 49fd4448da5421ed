"""A policy that computes a chunk for longer than it lasts, under LeRobot's real-time engine."""

import logging
import time
from threading import Event
from types import SimpleNamespace

import pytest
import torch
from cases_diffusion_chunked import DIFFUSION
from fake_robot import JOINTS, FakeRobot
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.factory import make_pre_post_processors
from lerobot.policies.rtc.configuration_rtc import RTCConfig
from lerobot.rollout.context import RuntimeContext
from lerobot.rollout.inference.factory import RTCInferenceConfig, create_inference_engine
from lerobot.rollout.inference.rtc import RTCInferenceEngine
from lerobot.rollout.robot_wrapper import ThreadSafeRobot
from lerobot.rollout.strategies.base import BaseStrategy
from lerobot.utils.feature_utils import hw_to_dataset_features

from lerobot_act_chunking.errors import ConfigurationError, FeatureError
from lerobot_act_chunking.policies.diffusion_chunked.configuration_diffusion_chunked import (
    DiffusionChunkedConfig,
)
from lerobot_act_chunking.policies.diffusion_chunked.modeling_diffusion_chunked import DiffusionChunkedPolicy

FPS, HORIZON = 100, 5  # a chunk lasts 50 ms
SHAPE = (len(JOINTS),)


class Robot(FakeRobot):
    """One that says whether it was let go."""

    is_connected = True

    def disconnect(self):
        self.is_connected = False


def make_policy(slow_chunks):
    """A policy whose first chunks, so many of them, take longer than they last."""
    torch.manual_seed(0)
    policy = DiffusionChunkedPolicy(
        DiffusionChunkedConfig(
            input_features={"observation.state": PolicyFeature(FeatureType.STATE, SHAPE)},
            output_features={"action": PolicyFeature(FeatureType.ACTION, SHAPE)},
            device="cpu",
            push_to_hub=False,
            **{**DIFFUSION, "horizon": HORIZON},
        )
    ).eval()
    policy.asked = 0

    def predict(batch, inference_delay=None, prev_chunk_left_over=None):
        policy.asked += 1
        time.sleep(2 * HORIZON / FPS if policy.asked <= slow_chunks else 0)
        return torch.zeros(1, HORIZON, *SHAPE)

    policy.predict_action_chunk = predict
    return policy


def roll_out(policy, robot, duration=3.0):
    """What `lerobot-rollout` does once everything is connected."""
    rtc = RTCInferenceConfig(RTCConfig(execution_horizon=2), queue_threshold=1)
    policy.config.rtc_config = rtc.rtc
    policy.init_rtc_processor()
    preprocessor, postprocessor = make_pre_post_processors(policy.config, dataset_stats=None)
    shutdown, wrapper = Event(), ThreadSafeRobot(robot)
    features = hw_to_dataset_features(robot.observation_features, "observation")
    engine = create_inference_engine(
        rtc,
        policy=policy,
        preprocessor=preprocessor,
        postprocessor=postprocessor,
        robot_wrapper=wrapper,
        hw_features=features,
        dataset_features=features,
        ordered_action_keys=list(JOINTS),
        task="",
        fps=FPS,
        device="cpu",
        shutdown_event=shutdown,
    )
    context = SimpleNamespace(
        policy=SimpleNamespace(inference=engine),
        runtime=RuntimeContext(
            shutdown_event=shutdown,
            cfg=SimpleNamespace(
                fps=FPS,
                duration=duration,
                use_torch_compile=False,
                display_data=False,
                interpolation_multiplier=1,
                return_to_initial_position=False,
            ),
        ),
        hardware=SimpleNamespace(robot_wrapper=wrapper, teleop=None, initial_position=None),
        processors=SimpleNamespace(
            robot_observation_processor=lambda observation: observation,
            robot_action_processor=lambda action_and_observation: action_and_observation[0],
        ),
        data=SimpleNamespace(dataset_features=features, ordered_action_keys=list(JOINTS)),
    )
    strategy = BaseStrategy(SimpleNamespace())
    try:
        strategy.setup(context)
        strategy.run(context)
    finally:
        strategy.teardown(context)


def test_a_rollout_in_which_every_chunk_is_late_ends_with_the_reason(caplog):
    policy, robot = make_policy(slow_chunks=1000), Robot(3.0)
    with caplog.at_level(logging.WARNING), pytest.raises(ConfigurationError, match=r"--inference\.type=sync"):
        roll_out(policy, robot, duration=60.0)
    assert robot.actions == []
    assert not robot.is_connected
    warned = [record for record in caplog.records if "none of its actions" in record.message]
    assert len(warned) == 1


def test_a_slow_start_is_forgiven():
    policy, robot = make_policy(slow_chunks=2), Robot(3.0)
    roll_out(policy, robot, duration=1.0)
    assert len(robot.actions) > 10


def test_an_error_of_ours_in_the_engines_thread_ends_the_rollout_with_it():
    policy, robot = make_policy(slow_chunks=0), Robot(3.0)

    def predict(batch, inference_delay=None, prev_chunk_left_over=None):
        raise FeatureError("observation.state has 5 values, not 6")

    policy.predict_action_chunk = predict
    with pytest.raises(FeatureError, match="5 values"):
        roll_out(policy, robot, duration=60.0)
    assert not robot.is_connected


def test_an_error_of_one_rollout_does_not_end_the_next():
    policy, broken = make_policy(slow_chunks=0), True
    works = policy.predict_action_chunk

    def predict(batch, inference_delay=None, prev_chunk_left_over=None):
        if broken:
            raise FeatureError("observation.state has 5 values, not 6")
        return works(batch, inference_delay, prev_chunk_left_over)

    policy.predict_action_chunk = predict
    with pytest.raises(FeatureError):
        roll_out(policy, Robot(3.0), duration=60.0)
    broken, robot = False, Robot(3.0)
    roll_out(policy, robot, duration=1.0)
    assert len(robot.actions) > 10


def test_other_policies_are_left_to_lerobot():
    make_policy(slow_chunks=0).init_rtc_processor()
    engine = RTCInferenceEngine.__new__(RTCInferenceEngine)
    engine._policy, engine._fps = SimpleNamespace(config=SimpleNamespace()), FPS
    engine._action_queue = SimpleNamespace(get=lambda: None, get_with_task=lambda: None)
    for _ in range(5):
        engine._action_queue.original_queue = torch.zeros(0, *SHAPE)
        assert engine.get_action(None) is None
