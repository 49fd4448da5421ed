import subprocess
import sys

import pytest

from lerobot_act_chunking.cli import main as cli
from lerobot_act_chunking.errors import ConfigurationError


def test_help_answers_without_importing_torch_or_lerobot():
    code = (
        "import sys; from lerobot_act_chunking.cli.main import main; status = main(['--help']);"
        "print('imported:', sorted({'torch', 'lerobot', 'mujoco', 'datasets'} & set(sys.modules)), status)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout.splitlines()[-1] == "imported: [] 0"
    for command in ("record", "motion", "settings"):
        assert command in done.stdout


def test_our_errors_are_one_line_and_status_1(monkeypatch, capsys):
    def refuse(**_):
        raise ConfigurationError("chunk_size=7 must be divisible by 2")

    monkeypatch.setattr(cli, "app", refuse)
    assert cli.main([]) == 1
    assert capsys.readouterr().err == "error: chunk_size=7 must be divisible by 2\n"


def test_ctrl_c_is_status_130_and_says_how_to_go_on(monkeypatch, capsys, tmp_path):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("lerobot_act_chunking.recording.record", interrupted)
    assert cli.main(["record", "--repo-id", "me/cube", "--root", str(tmp_path / "cube")]) == 130
    assert "run the same command again" in capsys.readouterr().err


def test_errors_that_are_not_ours_keep_their_traceback(monkeypatch):
    def broken(**_):
        raise ZeroDivisionError

    monkeypatch.setattr(cli, "app", broken)
    with pytest.raises(ZeroDivisionError):
        cli.main([])


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (["fly"], "No such command 'fly'"),
        (["record", "--episodes", "few"], "Invalid value for '--episodes'"),
        (["motion", "--speed", "3"], "No such option: --speed"),
    ],
)
def test_usage_errors_are_status_2(argv, message, capsys):
    assert cli.main(argv) == 2
    assert message in capsys.readouterr().err
