"""Prefix weights and guidance beside LeRobot's RTCProcessor, whose time runs from 1 to 0."""

from functools import partial

import pytest
import torch
from lerobot.configs import RTCAttentionSchedule
from lerobot.policies.common.flow_matching import euler_integrate
from lerobot.policies.rtc.configuration_rtc import RTCConfig
from lerobot.policies.rtc.modeling_rtc import RTCProcessor
from torch import nn

from lerobot_act_chunking.sampling.continuation import continued, prefix_weights

B, T, A = 3, 12, 4
N_STEPS = 10
TIMES = 1 - (1 - torch.arange(N_STEPS) / N_STEPS).double()  # rounded as LeRobot's
MAX_WEIGHT = 10.0


def processor(schedule="linear", execution_horizon=8):
    return RTCProcessor(
        RTCConfig(
            prefix_attention_schedule=RTCAttentionSchedule[schedule.upper()],
            max_guidance_weight=MAX_WEIGHT,
            execution_horizon=execution_horizon,
        )
    )


@pytest.mark.parametrize("schedule", [each.name.lower() for each in RTCAttentionSchedule])
def test_prefix_weights(schedule):
    theirs = processor(schedule)
    for start in range(8):
        for end in range(10):
            for total in (1, 3, 7):
                ours = prefix_weights(start, end, total, schedule)
                torch.testing.assert_close(ours, theirs.get_prefix_weights(start, end, total))


def at_times(field):
    return lambda x, i: field(x, TIMES[i])


class Field(nn.Module):
    """A clean-action estimate that depends on everything and on the time."""

    def __init__(self):
        super().__init__()
        torch.manual_seed(0)
        self.steps, self.dims = nn.Conv1d(T, T, 3, padding=1), nn.Linear(A, A)
        self.double()

    def forward(self, x, t):
        return self.dims(nn.functional.mish(self.steps(x)) + t)


@pytest.mark.parametrize(("delay", "length"), [(0, 12), (3, 12), (3, 5)])
@pytest.mark.parametrize("schedule", ["linear", "exp", "zeros"])
def test_ten_euler_steps_with_the_identity_are_lerobots(schedule, delay, length):
    generator = torch.Generator().manual_seed(1)
    noise, plan = torch.randn(2, B, T, A, dtype=torch.float64, generator=generator)
    field = Field()
    theirs = euler_integrate(
        lambda x, time: (x - field(x, 1 - time.double()[:, None, None])) / time.double()[:, None, None],
        noise,
        N_STEPS,
        rtc_processor=processor(schedule),
        rtc_enabled=True,
        inference_delay=delay,
        prev_chunk_left_over=plan[:, :length],
    ).detach()
    weights = prefix_weights(delay, min(8, length), T, schedule)[None]
    guided = continued(
        at_times(field), TIMES, 1 - TIMES, plan, weights, vjp="identity", max_weight=MAX_WEIGHT
    )
    with torch.inference_mode():
        ours, unguided = integrate(guided, noise), integrate(at_times(field), noise)
    torch.testing.assert_close(ours, theirs, rtol=0, atol=1e-6)
    assert (delay == 0 and schedule == "zeros") or (ours - unguided).abs().max() > 0.1


def integrate(denoise, x):
    for i, t in enumerate(TIMES):
        x = x + (denoise(x, i) - x) / (1 - t) / N_STEPS
    return x


def test_lerobots_correction_misses_the_jacobian():
    """Why there are two variants: theirs is computed before ``x_t`` asks for gradients."""
    generator = torch.Generator().manual_seed(1)
    x, plan = torch.randn(2, B, T, A, dtype=torch.float64, generator=generator)
    field, time = Field(), 0.5
    velocity = partial(lambda x, t: (x - field(x, t)) / time, t=1 - time)
    theirs = x - time * processor().denoise_step(x, plan, 2, time, velocity).detach()
    arguments = (
        torch.full((1,), 1 - time),
        torch.full((1,), time),
        plan,
        prefix_weights(2, 8, T, "linear")[None],
    )
    results = {
        vjp: continued(lambda x, i: field(x, 1 - time), *arguments, vjp=vjp, max_weight=MAX_WEIGHT)(x, 0)
        for vjp in ("exact", "identity")
    }
    torch.testing.assert_close(results["identity"], theirs, rtol=0, atol=1e-6)
    assert (results["exact"] - theirs).abs().max() > 0.1
