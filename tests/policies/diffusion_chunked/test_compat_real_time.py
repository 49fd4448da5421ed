"""Real-time chunking as LeRobot 0.7 asks for it, by the LeRobot that is installed."""

import pytest
import torch
from lerobot.policies.rtc.configuration_rtc import RTCConfig
from policy_cases import CASES, A

from lerobot_act_chunking.errors import ConfigurationError

DIFFUSION, PREFIX = (
    next(case for case in CASES if (case.type, case.name) == ("diffusion_chunked", name))
    for name in ("state", "prefix")
)


def rtc_in(mode):
    config = RTCConfig(execution_horizon=3)
    vars(config)["mode"] = mode  # 0.6.1 has no such field
    return config


def test_training_time_chunking_needs_a_policy_that_learned_it():
    policy = DIFFUSION.policy()
    policy.config.rtc_config = rtc_in("trained")  # as LeRobot's rollout does
    with pytest.raises(ConfigurationError, match=r"warm_start=prefix.*use --inference\.rtc\.mode=guided"):
        policy.init_rtc_processor()
    with pytest.raises(ConfigurationError, match="mode=trained needs"):
        DIFFUSION.config(rtc_config=rtc_in("trained"))


@pytest.mark.parametrize(
    ("settings", "rtc_config"),
    [
        ({}, None),
        ({}, RTCConfig()),
        ({}, rtc_in("guided")),
        ({"warm_start": "prefix"}, rtc_in("trained")),
    ],
)
def test_all_other_modes_act(settings, rtc_config):
    policy = PREFIX.policy(**settings)
    policy.config.rtc_config = rtc_config
    policy.init_rtc_processor()
    left_over = torch.zeros(1, 3, A)
    one = {key: value[:1] for key, value in PREFIX.batch().items()}
    chunk = policy.predict_action_chunk(one, inference_delay=1, prev_chunk_left_over=left_over)
    assert chunk.shape == (1, 5, A)
