"""The engine behind ``lerobot-rollout --inference.type=rtc``, with a robot whose time is ours.

LeRobot's own thread, queue and latency tracker are at work; while a chunk is computed, the robot carries out
`DELAY` actions, no more and no fewer. The policy has learnt sine waves of any phase, which its observation
does not tell: only the chunk under way says how to go on.
"""

import copy
import time
from threading import Event
from types import SimpleNamespace

import pytest
import torch
from fake_robot import JOINTS, FakeRobot
from lerobot.configs import FeatureType, PolicyFeature, RTCAttentionSchedule
from lerobot.policies.factory import make_pre_post_processors
from lerobot.policies.rtc.configuration_rtc import RTCConfig
from lerobot.rollout.inference import rtc
from lerobot.rollout.inference.factory import RTCInferenceConfig, create_inference_engine
from lerobot.rollout.inference.rtc import supports_rtc_inference
from lerobot.rollout.robot_wrapper import ThreadSafeRobot
from lerobot.utils.feature_utils import hw_to_dataset_features
from tiers import full_tier

from lerobot_act_chunking.policies.diffusion_chunked.configuration_diffusion_chunked import (
    DiffusionChunkedConfig,
)
from lerobot_act_chunking.policies.diffusion_chunked.modeling_diffusion_chunked import DiffusionChunkedPolicy

T, A, DELAY, EXECUTION_HORIZON, QUEUE_THRESHOLD = 20, 2, 3, 10, 12
FPS = 50
SPEED = 0.4  # [rad per step]
MEAN, STD = 3.0, 2.0  # of the actions, in the robot's units
FEATURE = {"observation.state": PolicyFeature(FeatureType.STATE, (A,))}
STATS = {key: {"mean": torch.full((A,), MEAN), "std": torch.full((A,), STD)} for key in ("action", *FEATURE)}


def waves(n, generator):
    """Chunks (n, T, A) of a sine and a cosine, normalised."""
    phase = 2 * torch.pi * torch.rand(n, 1, generator=generator) + SPEED * torch.arange(T)
    return torch.stack([phase.sin(), phase.cos()], dim=-1)


@pytest.fixture(scope="module")
def trained():
    torch.manual_seed(0)
    config = DiffusionChunkedConfig(
        input_features=FEATURE,
        output_features={"action": PolicyFeature(FeatureType.ACTION, (A,))},
        horizon=T,
        actions_per_token=1,
        dim_model=32,
        n_layers=2,
        prefix_steps=4,
        use_ema=False,
        device="cpu",
        push_to_hub=False,
    )
    policy, generator = DiffusionChunkedPolicy(config), torch.Generator().manual_seed(1)
    optimizer = torch.optim.Adam(policy.parameters(), 3e-3)
    batch = {"observation.state": torch.zeros(64, A), "action_is_pad": torch.zeros(64, T, dtype=torch.bool)}
    policy.train()
    for _ in range(400):
        loss, _ = policy.forward({**batch, "action": waves(64, generator)})
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return policy.eval()


class Rollout:
    """LeRobot's rtc loop around a policy: what ``lerobot-rollout`` sets up, without its command line."""

    def __init__(self, policy, monkeypatch, *, ignore_left_over=False, **settings):
        self.robot, self.calls, self.merged = FakeRobot(MEAN), [], Event()
        self.policy = self._observed(policy, ignore_left_over)
        schedule = RTCAttentionSchedule.EXP
        config = RTCInferenceConfig(
            RTCConfig(prefix_attention_schedule=schedule, execution_horizon=EXECUTION_HORIZON, **settings),
            queue_threshold=QUEUE_THRESHOLD,
        )
        policy.config.rtc_config = config.rtc
        preprocessor, postprocessor = make_pre_post_processors(policy.config, dataset_stats=STATS)
        self.engine = create_inference_engine(
            config,
            policy=policy,
            preprocessor=preprocessor,
            postprocessor=postprocessor,
            robot_wrapper=ThreadSafeRobot(self.robot),
            hw_features=hw_to_dataset_features(self.robot.observation_features, "observation"),
            dataset_features={},
            ordered_action_keys=list(JOINTS),
            task="",
            fps=FPS,
            device="cpu",
        )
        clock = SimpleNamespace(perf_counter=lambda: self.robot.time, sleep=lambda s: time.sleep(s / 10))
        monkeypatch.setattr(rtc, "time", clock)

    def _observed(self, policy, ignore_left_over):
        """While it predicts, the robot goes on."""
        predict = policy.predict_action_chunk

        def predict_while_the_robot_moves(batch, *, inference_delay, prev_chunk_left_over):
            given = None if ignore_left_over else prev_chunk_left_over
            chunk = predict(batch, inference_delay=inference_delay, prev_chunk_left_over=given)
            for _ in range(DELAY):
                self.step()
            self.robot.time += (DELAY - 0.5) / FPS
            call = {"delay": inference_delay, "left_over": prev_chunk_left_over, "chunk": chunk}
            self.calls.append(SimpleNamespace(**call, at=len(self.robot.actions)))
            return chunk

        policy.predict_action_chunk = predict_while_the_robot_moves
        return policy

    def step(self):
        """One turn of the control loop."""
        self.engine.notify_observation(self.robot.get_observation())
        action = self.engine.get_action(None)
        if action is not None:
            self.robot.send_action(dict(zip(JOINTS, action.tolist(), strict=True)))

    def run(self, n_chunks):
        self.engine.start()
        self.engine.notify_observation(self.robot.get_observation())
        self.engine.resume()
        try:
            deadline = time.monotonic() + 60
            while len(self.calls) < n_chunks and not self.engine.failed:
                assert time.monotonic() < deadline, f"{len(self.calls)} chunks"
                if self.engine.action_queue.qsize() > QUEUE_THRESHOLD:
                    self.step()
                time.sleep(0.001)
        finally:
            self.engine.stop()
            del self.policy.predict_action_chunk
        assert not self.engine.failed
        return self

    @property
    def takeovers(self):
        """The step from the last action of one chunk to the first of the next, over the waves' own step."""
        actions = torch.stack(self.robot.actions)
        at = torch.tensor([call.at for call in self.calls[1:] if call.at < len(actions)])
        usual = STD * 2 * torch.tensor(SPEED / 2).sin()
        return (actions[at] - actions[at - 1]).norm(dim=1) / usual


@pytest.fixture
def policy(trained):
    """A copy that a test may change."""
    policy = copy.deepcopy(trained)
    policy.reset()
    return policy


@full_tier
def test_the_engine_takes_the_policy(policy):
    assert supports_rtc_inference(policy)


WAYS = {
    "none": {"warm_start": "none"},
    "rtc exact": {"warm_start": "rtc", "rtc_vjp": "exact"},
    "rtc identity": {"warm_start": "rtc", "rtc_vjp": "identity"},
    "prefix": {"warm_start": "prefix"},
}


@pytest.mark.parametrize("way", WAYS)
def test_chunks_continue_each_other(way, policy, monkeypatch):
    """Even without a warm start of its own: who asks for rtc on the command line gets it."""
    for name, value in WAYS[way].items():
        setattr(policy.config, name, value)
    rollout = Rollout(policy, monkeypatch).run(n_chunks=12)
    assert rollout.takeovers.median() < 1.3
    assert rollout.takeovers.max() < 2.5
    for before, call in zip(rollout.calls, rollout.calls[1:], strict=False):
        assert call.delay == DELAY
        frozen = call.chunk[0, :DELAY] - call.left_over[:DELAY]
        assert frozen.abs().max() < (1e-6 if way == "prefix" else 0.5)
        assert not call.chunk.requires_grad
        assert before.chunk.shape == (1, T, A)


def test_chunks_that_do_not_know_of_each_other_jump(policy, monkeypatch):
    rollout = Rollout(policy, monkeypatch, ignore_left_over=True).run(n_chunks=12)
    assert rollout.takeovers.median() > 2


def test_what_is_left_comes_back_normalised_and_from_now_on(policy, monkeypatch):
    rollout = Rollout(policy, monkeypatch).run(n_chunks=4)
    used = T - QUEUE_THRESHOLD  # rows that are gone when the next chunk is asked for
    for before, call in zip(rollout.calls, rollout.calls[1:], strict=False):
        assert torch.equal(call.left_over, before.chunk[0, used : used + EXECUTION_HORIZON])


def predict(policy, **arguments):
    noise = torch.randn(1, T, A, generator=torch.Generator().manual_seed(2))
    return policy.predict_action_chunk({"observation.state": torch.zeros(1, A)}, noise=noise, **arguments)


class TestWithoutTheEngine:
    left_over = waves(1, torch.Generator().manual_seed(3))[0, :EXECUTION_HORIZON]

    def test_a_left_over_counts(self, policy):
        continued = predict(policy, inference_delay=DELAY, prev_chunk_left_over=self.left_over)
        assert (continued - predict(policy)).abs().max() > 0.3
        assert (continued[0, :DELAY] - self.left_over[:DELAY]).abs().max() < 0.5
        batched = predict(policy, inference_delay=DELAY, prev_chunk_left_over=self.left_over[None])
        assert torch.equal(batched, continued)

    def test_a_robot_out_of_actions_has_nothing_to_continue(self, policy):
        """LeRobot's engine then hands over zeros."""
        nothing = torch.zeros(EXECUTION_HORIZON, A)
        assert torch.equal(
            predict(policy, inference_delay=DELAY, prev_chunk_left_over=nothing), predict(policy)
        )

    def test_padding_behind_what_is_left_does_not_count(self, policy):
        short = self.left_over[:5]
        padded = torch.cat([short, torch.zeros(5, A)])
        results = [
            predict(policy, inference_delay=DELAY, prev_chunk_left_over=each) for each in (short, padded)
        ]
        assert torch.equal(*results)

    def test_an_engine_that_appends_chunks_needs_no_continuation(self, policy):
        policy.config.rtc_config = RTCConfig(enabled=False)
        assert torch.equal(
            predict(policy, inference_delay=DELAY, prev_chunk_left_over=self.left_over), predict(policy)
        )

    def test_what_the_command_line_asks_for_wins(self, policy):
        policy.config.rtc_config = RTCConfig(max_guidance_weight=1e-6)
        continued = predict(policy, inference_delay=DELAY, prev_chunk_left_over=self.left_over)
        assert (continued - predict(policy)).abs().max() < 1e-3


def test_a_new_episode_starts_afresh(policy, monkeypatch):
    rollout = Rollout(policy, monkeypatch).run(n_chunks=3)
    rollout.engine.reset()
    assert rollout.engine.action_queue.qsize() == 0
    again = Rollout(policy, monkeypatch).run(n_chunks=1)
    assert again.calls[0].left_over is None
    assert not torch.equal(again.calls[0].chunk, rollout.calls[0].chunk)  # its noise is the second episode's
