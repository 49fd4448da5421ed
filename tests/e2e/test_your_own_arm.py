"""The commands of "Your own arm" and of "When it goes wrong", run as it stands there, on a simulated arm."""

import re

import pytest
from page_commands import ROOT, SMALLER, Terminal, commands, smaller
from tiers import full_tier

ARM = commands(ROOT / "docs" / "guides" / "your-own-arm.md")
WRONG = commands(ROOT / "docs" / "guides" / "when-it-goes-wrong.md")
INSTALL = "pip install "


def test_the_pages_have_commands_and_sizes_that_a_test_can_make_smaller():
    text = "\n".join([*ARM, *WRONG])
    assert len(ARM) > 15
    assert len(WRONG) > 12
    assert [size for size in SMALLER if size not in text] == []
    known = re.compile(r"act-chunking|lerobot-|python -m|pip|[A-Z]+=")
    assert [each for each in (*ARM, *WRONG) if not known.match(each)] == []
    assert len([each for each in ARM if each.startswith(INSTALL)]) == 1


@full_tier
@pytest.mark.timeout(3600)
def test_both_pages_from_the_first_command_to_the_last(tmp_path):
    terminal = Terminal(tmp_path)
    try:
        said = {each: terminal.run(smaller(each)) for each in ARM if not each.startswith(INSTALL)}
        said |= {each: terminal.run(smaller(each)) for each in WRONG}
    finally:
        terminal.close()
    (client,) = [said[each] for each in ARM if "robot_client" in each]
    assert "Failed to connect" not in client
    assert "Control loop thread starting" in client
    rollouts = [text for each, text in said.items() if each.startswith("lerobot-rollout")]
    assert len(rollouts) > 8
    assert all("so_arm_sim: the episode of seed" in text for text in rollouts)
    assert (tmp_path / "replay.png").is_file()
