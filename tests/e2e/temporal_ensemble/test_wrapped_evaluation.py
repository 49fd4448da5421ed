"""LeRobot's own commands over checkpoints of LeRobot's policies and of ours, wrapped."""

import shutil

import pytest
import torch
from evaluations import EPISODES, INNER, STEPS, checkpoint
from tiers import some

from lerobot_act_chunking.cli.wrap import wrap_command

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("policy_type", some(1, INNER))
def test_lerobot_eval_over_a_checkpoint_and_over_its_wrapped_copy(policy_type, evaluate, tmp_path):
    inner = checkpoint(policy_type, tmp_path / "inner")
    episodes, chunks = evaluate(
        "--policy.type=temporal_ensemble", f"--policy.inner_path={inner}", "--policy.replan_interval=5"
    )
    assert (episodes, len(chunks)) == (EPISODES, STEPS // 5)
    wrap_command(str(inner), tmp_path / "wrapped", replan_interval=5)
    shutil.rmtree(inner)
    _, copied = evaluate(f"--policy.path={tmp_path / 'wrapped'}")
    for chunk, copy in zip(chunks, copied, strict=True):
        assert torch.equal(chunk, copy)


def test_another_execution_on_the_command_line(evaluate, tmp_path):
    wrap_command(str(checkpoint("act", tmp_path / "inner")), tmp_path / "wrapped")
    _, chunks = evaluate(f"--policy.path={tmp_path / 'wrapped'}", "--policy.execution=open_loop")
    assert len(chunks) == 2


def test_lerobot_eval_refuses_a_wrapper_over_nothing(evaluate, capfd):
    with pytest.raises(SystemExit):
        evaluate("--policy.type=temporal_ensemble")
    assert "set either --policy.inner_path=<checkpoint> or --policy.inner=" in capfd.readouterr().err
