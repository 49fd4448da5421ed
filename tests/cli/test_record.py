import os
import signal
import subprocess
import sys
import time

import pytest
from tiers import full_tier

from lerobot_act_chunking.cli.main import main
from lerobot_act_chunking.recording import RecordSpec, read_summary, record


def test_a_recording_and_the_same_command_again(tmp_path, capsys):
    root = tmp_path / "cube"
    command = ["record", "--task", "transfer_cube", "--episodes", "2", "--obs", "state"]
    command += ["--repo-id", "me/cube", "--root", str(root), "--seed", "5", "--speed", "1.1", "--velocity"]
    assert main(command) == 0
    out = capsys.readouterr().out
    assert "recorded: 2 episodes" in out
    assert "the expert succeeded in 2 of 2 attempts" in out
    assert str(root) in out
    summary = read_summary(root)
    assert [episode.seed for episode in summary.episodes] == [5, 6]
    assert summary.settings["expert"]["speed"] == 1.1
    assert summary.settings["agent_vel"]
    assert main(command) == 0
    assert "was already complete: 2 episodes" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--task", "juggle"], "error: unknown task 'juggle'; choose one of: transfer_cube, insertion"),
        (["--obs", "pixels", "--cameras", "top,back"], "error: unknown camera 'back'; choose one of: top,"),
        (["--obs", "pixels", "--image-height", "-3"], "observation_height is a whole number of pixels"),
        (
            ["--obs", "pixels", "--image-width", "33"],
            "error: image_width is 33; H.264 videos need even sizes",
        ),
        (["--cameras", "top"], "error: obs state records no cameras, got top"),
        (["--episodes", "0"], "error: episodes=0 must be at least 1"),
        (["--workers", "-2"], "error: workers=-2 must be at least 1"),
        (["--repo-id", "cube"], "error: repo id 'cube' is not of the form user/name"),
        (["--success", "luck"], "error: unknown success rule 'luck'; choose one of: touch, hold"),
        (["--speed", "9"], "error: expert option speed=9.0 is outside"),
        (["--action-noise", "-1"], "error: expert option action_noise=-1.0 is outside"),
        (["--root", "/proc/cube"], "error: cannot write to /proc"),
    ],
)
def test_wrong_inputs_are_one_line_and_status_1(options, message, tmp_path, capsys):
    command = ["record", "--repo-id", "me/cube", "--root", str(tmp_path / "cube"), *options]
    assert main(command) == 1
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (["record"], "Missing option '--repo-id'"),
        (["record", "--repo-id", "me/cube", "--episodes", "many"], "Invalid value for '--episodes'"),
    ],
)
def test_usage_errors_are_status_2(command, message, capsys):
    assert main(command) == 2
    assert message in capsys.readouterr().err


@full_tier
@pytest.mark.parametrize("finished", [1, 5])
def test_the_command_killed_for_real_resumes(tmp_path, finished):
    """Kill -9 on the whole command, workers and all, at no moment in particular."""
    root, episodes = tmp_path / "cube", tmp_path / ".cube.recording" / "episodes"
    command = [sys.executable, "-m", "lerobot_act_chunking.cli.main", "record", "--repo-id", "me/cube"]
    command += ["--root", str(root), "--episodes", "8", "--workers", "2"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, start_new_session=True) as process:
        while process.poll() is None and len(list(episodes.glob("seed-*.npz"))) < finished:
            time.sleep(0.02)
        os.killpg(process.pid, signal.SIGKILL)
    assert not root.exists()
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=200)
    assert "recorded: 8 episodes" in done.stdout
    assert done.stderr == ""
    record(RecordSpec("me/cube", tmp_path / "undisturbed", episodes=8))
    recorded, expected = ({path.relative_to(folder): path.read_bytes() for path in folder.rglob("*.*")}
                          for folder in (root, tmp_path / "undisturbed"))  # fmt: skip
    assert recorded == expected
