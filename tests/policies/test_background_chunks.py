"""Policies whose chunks are computed in a thread act as those whose chunks are used as much later."""

import pytest
import torch
from policy_cases import CASES, WRAPPED, of_every_type
from tiers import some

EVERY = some(9, [*CASES, *WRAPPED, *of_every_type("KEPT")], by=lambda case: case.type)
STEPS, TIMING = 9, {"replan_interval": 2, "crossfade_steps": None, "execution": "receding"}


@pytest.mark.parametrize("case", EVERY, ids=lambda case: f"{case.type}-{case.name}")
def test_a_chunk_that_is_there_at_the_next_step_is_one_with_a_latency_of_one(case):
    late = actions(case, case.policy(**TIMING, background=True))
    expected = actions(case, case.policy(**TIMING, latency_steps=1))
    torch.testing.assert_close(late, expected, rtol=0, atol=0)


def actions(case, policy):
    policy.reset()
    generator, chosen = torch.Generator().manual_seed(3), []
    one = {key: value for key, value in case.batch(1).items() if key.startswith("observation")}
    for _ in range(STEPS):
        batch = {key: value + torch.randn(value.shape, generator=generator) for key, value in one.items()}
        chosen.append(policy.select_action(batch))
        awaited = getattr(policy._action_queue.arrays, "_awaited", None)
        if awaited is not None:
            awaited.future.result()
    return torch.stack(chosen)
