"""``act-chunking serve``: what it prints, and what it refuses before anything listens."""

import sys

import pytest

from lerobot_act_chunking.cli.main import main


def test_a_checkpoint_that_is_not_there_is_refused(capsys, tmp_path):
    assert main(["serve", str(tmp_path / "nothing")]) == 1
    assert "there is no checkpoint" in capsys.readouterr().err


def test_without_the_extra_the_pip_command_is_named(capsys, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "grpc", None)
    monkeypatch.delitem(sys.modules, "lerobot_act_chunking.serving.server", raising=False)
    assert main(["serve", str(tmp_path)]) == 1
    assert "pip install 'lerobot_policy_act_chunking[serve]'" in capsys.readouterr().err


def test_a_lerobot_with_another_server_is_said_to_have_one(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr("lerobot_act_chunking.cli.serve.find_spec", lambda name: None)
    assert main(["serve", str(tmp_path)]) == 1
    assert "lerobot-policy-server" in capsys.readouterr().err


@pytest.mark.parametrize(("host", "warned"), [("127.0.0.1", False), ("0.0.0.0", True)])
@pytest.mark.parametrize("type_", ["act_chunked", "act"])
def test_the_client_s_command_is_printed_and_a_network_warned_of(capsys, monkeypatch, type_, host, warned):
    from types import SimpleNamespace

    from lerobot.configs import PreTrainedConfig

    from lerobot_act_chunking.serving import server

    stopped = []
    listening = SimpleNamespace(
        wait_for_termination=lambda: None,
        stop=lambda grace: SimpleNamespace(wait=lambda: stopped.append(grace)),
    )
    config = PreTrainedConfig.get_choice_class(type_)(chunk_size=40, n_action_steps=40)
    monkeypatch.setattr(server.Served, "of", lambda path, settings: server.Served(path, config))
    monkeypatch.setattr(server, "start", lambda served, host, port: listening)
    assert main(["serve", "a/folder", "--host", host, "--port", "9000"]) == 0
    printed = capsys.readouterr().out
    assert f"--server_address={host}:9000 --policy_type={type_} " in printed
    assert ("--aggregate_fn_name=latest_only" in printed) is (type_ == "act_chunked")
    assert "--pretrained_name_or_path=a/folder --actions_per_chunk=40" in printed
    assert ("carries pickles" in printed) is warned
    assert stopped
