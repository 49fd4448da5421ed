"""Interfaces of policies that cannot be built without downloads, and of LeRobot's rollout engines."""

import time

import numpy as np
import pytest
import torch
from lerobot.policies.rtc.configuration_rtc import RTCConfig
from lerobot.processor import make_default_pre_post_processors
from lerobot.rollout.inference.rtc import RTCInferenceEngine, supports_rtc_inference
from lerobot.rollout.inference.sync import SyncInferenceEngine
from stand_ins import STAND_INS, TOKENS, A, S, bare, batch, stand_ins, wrapped  # noqa: F401  (a fixture)
from wrapped_cases import ACT, B

JOINTS = [f"joint_{i}.pos" for i in range(A)]


@pytest.fixture(params=STAND_INS)
def policy_type(request, stand_ins):  # noqa: F811
    return request.param


def act(policy, seeds):
    """The actions on other observations in each step, and one and the same instruction."""
    told = {TOKENS: batch(0)[TOKENS]}
    return torch.stack([policy.select_action({**batch(seed), **told}) for seed in seeds])


def test_open_loop_is_the_bare_policy_bit_for_bit(policy_type):
    policy = wrapped(policy_type, execution="open_loop", n_action_steps=3)
    assert torch.equal(act(policy, range(8)), act(bare(policy_type), range(8)))


def test_environments_are_replanned_alone_with_their_own_words_and_history(policy_type):
    together, other = (wrapped(policy_type, replan_interval=2) for _ in range(2))
    act(together, range(3))
    act(other, range(3))
    together.reset(torch.tensor([1]))
    after, undisturbed = act(together, range(3, 7)), act(other, range(3, 7))
    torch.testing.assert_close(after[:, [0, 2]], undisturbed[:, [0, 2]])
    torch.testing.assert_close(after[:, 1], act(wrapped(policy_type, replan_interval=2), range(3, 7))[:, 1])


def test_the_batch_is_never_changed(policy_type):
    given = batch(0)
    before = {key: value.clone() for key, value in given.items() if torch.is_tensor(value)}
    policy = wrapped(policy_type)
    policy.select_action(given)
    policy.predict_action_chunk(given)
    policy.forward(given)
    for key, value in before.items():
        assert torch.equal(given[key], value), key


def test_several_samples_of_everything_are_asked_for_at_once(policy_type):
    policy = wrapped(policy_type, execution="coherence", n_samples=4, replan_interval=2)
    policy._observations.observe(batch(0))
    samples = policy._prepare(batch(0), torch.tensor([2, 0]))()
    assert samples.shape == (4, 2, 7, A)
    assert torch.equal(samples, samples[:1].expand_as(samples))
    torch.testing.assert_close(samples[0], wrapped(policy_type).predict_action_chunk(batch(0))[[2, 0]])


def test_losses_per_sample_are_passed_on(policy_type):
    loss, _ = wrapped(policy_type).forward(batch(0), reduction="none")
    assert loss.shape == (3,)


def test_arguments_of_real_time_chunking_reach_a_policy_that_knows_them(stand_ins):  # noqa: F811
    vla, dit = wrapped("smolvla"), wrapped("multi_task_dit")
    left, noise = torch.zeros(2, A), torch.zeros(3, 7, A)
    vla.predict_action_chunk(batch(0), inference_delay=2, prev_chunk_left_over=left, noise=noise)
    assert vla.inner.received == [{"inference_delay": 2, "prev_chunk_left_over": left, "noise": noise}]
    dit.predict_action_chunk(batch(0), inference_delay=2, prev_chunk_left_over=left)
    assert supports_rtc_inference(vla)
    assert supports_rtc_inference(dit)
    assert supports_rtc_inference(ACT.wrapped())


def test_a_chunk_of_a_policy_that_continues_none_goes_over_from_what_is_left():
    wrapped, left_over = ACT.wrapped(execution="crossfade", crossfade_steps=1), torch.full((B, 3, A), 9.0)
    chunk = wrapped.predict_action_chunk(ACT.batch(), inference_delay=1, prev_chunk_left_over=left_over)
    alone = wrapped.predict_action_chunk(ACT.batch())
    assert torch.equal(chunk[:, 0], left_over[:, 0])
    torch.testing.assert_close(chunk[:, 1], (9.0 + alone[:, 1]) / 2)
    assert torch.equal(chunk[:, 2:], alone[:, 2:])


def test_the_settings_of_real_time_chunking_reach_the_inner_policy(stand_ins):  # noqa: F811
    policy, settings = wrapped("smolvla"), RTCConfig()
    policy.config.rtc_config = settings  # as LeRobot does
    policy.init_rtc_processor()
    assert policy.inner.rtc_config is settings


def frame(generator):
    return {
        f"observation.{name}": generator.normal(size=n).astype(np.float32)
        for name, n in (("state", S), ("environment_state", 7))
    }


def test_lerobots_synchronous_engine_acts_as_the_policy():
    policy, reference = ACT.wrapped(replan_interval=2), ACT.wrapped(replan_interval=2)
    preprocessor, postprocessor = make_default_pre_post_processors(policy.config, None)
    engine = SyncInferenceEngine(
        policy=policy,
        preprocessor=preprocessor,
        postprocessor=postprocessor,
        dataset_features={"action": {"dtype": "float32", "shape": (A,), "names": JOINTS}},
        ordered_action_keys=JOINTS,
        task="fold",
        device="cpu",
        robot_type="toy",
    )
    for rollout in range(2):
        engine.reset()
        reference.reset()
        generator = np.random.default_rng(rollout)
        for _ in range(5):
            observed = frame(generator)
            tensors = {key: torch.from_numpy(value)[None] for key, value in observed.items()}
            torch.testing.assert_close(engine.get_action(observed), reference.select_action(tensors)[0])


class Robot:
    """The part of a robot that the engine asks about."""

    robot_type = "toy"
    action_features = dict.fromkeys(JOINTS, float)


def test_lerobots_real_time_chunking_engine_continues_chunks(stand_ins):  # noqa: F811
    policy = wrapped("smolvla")
    policy.config.rtc_config = RTCConfig(execution_horizon=3)
    policy.init_rtc_processor()
    preprocessor, postprocessor = make_default_pre_post_processors(policy.config, None)
    names = [f"joint_{i}.pos" for i in range(S)]
    engine = RTCInferenceEngine(
        policy=policy,
        preprocessor=preprocessor,
        postprocessor=postprocessor,
        robot_wrapper=Robot(),
        rtc_config=policy.config.rtc_config,
        hw_features={
            "observation.state": {"dtype": "float32", "shape": (S,), "names": names},
            "observation.images.left": {"dtype": "image", "shape": (8, 8, 3), "names": None},
            "observation.images.right": {"dtype": "image", "shape": (8, 8, 3), "names": None},
        },
        task="fold",
        fps=50.0,
        device="cpu",
        rtc_queue_threshold=5,
    )
    camera = np.zeros((8, 8, 3), np.uint8)
    engine.start()
    engine.notify_observation({**dict.fromkeys(names, 0.5), "left": camera, "right": camera})
    engine.resume()
    try:
        actions = wait_for_actions(engine, 9)
    finally:
        engine.stop()
    assert not engine.failed
    assert all(action.shape == (A,) for action in actions)
    first, *later = policy.inner.received
    assert first["prev_chunk_left_over"] is None
    assert later[0]["prev_chunk_left_over"].shape == (3, A)


def wait_for_actions(engine, count, patience=20.0):
    actions, deadline = [], time.monotonic() + patience
    while len(actions) < count and time.monotonic() < deadline and not engine.failed:
        action = engine.get_action(None)
        if action is None:
            time.sleep(0.01)
        else:
            actions.append(action)
    assert len(actions) == count
    return actions
