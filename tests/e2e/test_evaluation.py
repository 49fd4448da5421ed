"""LeRobot's evaluation of our policies, with settings on the command line."""

import pytest
import torch
from evaluations import EPISODES, STEPS, checkpoint
from policy_cases import of_every_type
from tiers import some

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("policy_type", "settings"), some(3, of_every_type("EVALUATED"), by=lambda case: case[0])
)
def test_sampling_is_set_on_the_command_line(policy_type, settings, evaluate, tmp_path):
    path = checkpoint(policy_type, tmp_path / "policy")
    episodes, chunks = evaluate(f"--policy.path={path}", "--policy.replan_interval=4", *settings.split())
    assert (episodes, len(chunks)) == (EPISODES, STEPS // 4)
    assert all(torch.isfinite(chunk).all() for chunk in chunks)
