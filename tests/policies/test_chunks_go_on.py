"""LeRobot's real-time queue: a new chunk follows on what was executed, however long a control step takes."""

import lerobot.rollout.inference.rtc as engine_module
import pytest
import torch
from lerobot.policies.rtc import ActionQueue
from lerobot.policies.rtc.configuration_rtc import RTCConfig
from policy_cases import any_config
from torch import nn

from lerobot_act_chunking.policies import late_chunks


@pytest.fixture
def engine(monkeypatch):
    """LeRobot's engine around a policy of ours, as after its start, without its thread."""
    engine_class = engine_module.RTCInferenceEngine
    original = getattr(engine_class.get_action, "__wrapped__", engine_class.get_action)
    monkeypatch.setattr(engine_class, "get_action", original)
    late_chunks.install()
    engine, policy = engine_class.__new__(engine_class), nn.Module()
    policy.config = any_config()
    vars(engine).update(_policy=policy, _action_queue=ActionQueue(RTCConfig()), _fps=30)
    return engine


@pytest.mark.parametrize("passed", [2, 3, 7])
def test_no_action_is_leapt_over_where_the_loop_is_slower_than_the_clock(engine, passed):
    queue, plan = engine.action_queue, torch.arange(40.0)[:, None].repeat(1, 4)
    assert engine.get_action(None) is None
    queue.merge(plan[:20], plan[:20], passed, 0)
    told = [engine.get_action(None)[0].item() for _ in range(10)]
    before = queue.get_action_index()
    told += [engine.get_action(None)[0].item() for _ in range(2)]
    queue.merge(plan[10:30], plan[10:30], passed, before)  # a chunk from the step of its observation on
    told += [engine.get_action(None)[0].item() for _ in range(5)]
    assert told == list(range(17))


def test_a_chunk_that_comes_too_late_altogether_leaves_nothing(engine):
    chunk = torch.zeros(5, 4)
    assert engine.get_action(None) is None
    engine.action_queue.merge(chunk, chunk, 6, 0)
    assert engine.get_action(None) is None
