"""LeRobot's own robot client, unchanged, and the server that every policy type acts through."""

import os
import socket
import threading
import time
from types import SimpleNamespace

import grpc
import numpy as np
import pytest
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.policies.factory import make_pre_post_processors
from policy_case import STATE, TOP
from policy_cases import KINDS, Case
from served_arm import JOINTS, ServedArm, ServedArmConfig

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.execution.limits import ActionLimits
from lerobot_act_chunking.policies.loading import load_policy
from lerobot_act_chunking.policies.saving import save_checkpoint
from lerobot_act_chunking.policies.temporal_ensemble.wrapping import load_wrapped
from lerobot_act_chunking.serving.server import ChunkServer, PolicyServerConfig, Served, start

FPS, N_ACTIONS = 60, 4
STATISTICS = {
    "observation.state": {"mean": torch.zeros(6), "std": torch.ones(6)},
    "observation.images.top": {"mean": torch.zeros(3, 1, 1), "std": torch.ones(3, 1, 1)},
    "action": {"mean": torch.full((4,), 2.0), "std": torch.full((4,), 3.0)}
    | {"min": torch.full((4,), -1.0), "max": torch.full((4,), 5.0)},
}
DETERMINISTIC = {
    "act_chunked": {},
    "diffusion_chunked": {"objective": "two_step"},
    "vqbet_chunked": {"bet_softmax_temperature": 1e-6},
}


@pytest.fixture(scope="module")
def checkpoints(tmp_path_factory):
    """One of each type, and one in a wrapper, by what they are called."""
    root, made = tmp_path_factory.mktemp("served"), {}
    for kind in KINDS:
        policy = Case("arm", kind, STATE | TOP, DETERMINISTIC[kind]).policy()
        parts = (policy, *make_pre_post_processors(policy.config, dataset_stats=STATISTICS))
        save_checkpoint(parts, root / kind)
        made[kind] = str(root / kind)
    save_checkpoint(load_wrapped(made["act_chunked"]), root / "wrapped")
    return {**made, "temporal_ensemble": str(root / "wrapped")}


@pytest.fixture(scope="module")
def address(checkpoints):
    port = free_port()
    server = start([Served.of(path) for path in checkpoints.values()], "127.0.0.1", port)
    yield f"127.0.0.1:{port}"
    server.stop(None).wait()


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def client_of(address, path, **settings):
    from lerobot.async_inference.configs import RobotClientConfig
    from lerobot.async_inference.robot_client import RobotClient

    robot = ServedArmConfig(**{name: settings.pop(name) for name in ("joints", "camera") if name in settings})
    kind = settings.pop("policy_type", None) or PreTrainedConfig.from_pretrained(path).type
    client = RobotClient(
        RobotClientConfig(
            kind,
            path,
            robot,
            N_ACTIONS,
            server_address=address,
            fps=FPS,
            chunk_size_threshold=0.0,
            **settings,
        )
    )
    assert isinstance(client.robot, ServedArm)
    return client


def act(client, n_actions):
    """Let the arm act until it was told so much."""
    threads = [
        threading.Thread(target=client.receive_actions, daemon=True),
        threading.Thread(target=client.control_loop, args=("",), daemon=True),
    ]
    for thread in threads:
        thread.start()
    until = time.monotonic() + 20
    while len(client.robot.actions) < n_actions and time.monotonic() < until:
        time.sleep(0.01)
    client.shutdown_event.set()
    for thread in threads:
        thread.join(5)
    return np.array(client.robot.actions[:n_actions])


SLOW = [pytest.param(kind, marks=pytest.mark.slow) for kind in [*list(KINDS)[1:], "temporal_ensemble"]]


@pytest.mark.parametrize("kind", [next(iter(KINDS)), *SLOW])
def test_the_arm_is_told_what_the_policy_predicts(checkpoints, address, kind):
    client = client_of(address, checkpoints[kind])
    assert client.start()
    told = act(client, 2 * N_ACTIONS)
    assert told.shape == (2 * N_ACTIONS, 4)

    loaded = load_policy(checkpoints[kind])
    seen = client.robot.get_observation()
    image = torch.from_numpy(seen["top"]).permute(2, 0, 1)[None] / 255
    state = torch.tensor([[seen[name] for name in JOINTS]], dtype=torch.float32)
    batch = loaded.preprocessor({"observation.state": state, "observation.images.top": image})
    with torch.inference_mode():
        chunk = loaded.postprocessor(loaded.policy.predict_action_chunk(batch))[0].numpy()
    # A chunk begins at the step of its observation, whose action a later chunk has as its first.
    np.testing.assert_allclose(told[:N_ACTIONS], chunk[:N_ACTIONS], rtol=1e-4, atol=1e-4)


def test_what_was_observed_before_is_no_history_of_what_comes_now():
    history = {"n_obs_steps": 2, "use_velocity": True, "execution": "receding", "replan_interval": 1}
    policy = Case("arm", "act_chunked", STATE, history).policy().eval()
    server = ChunkServer([], PolicyServerConfig())
    server.policy, server.actions_per_chunk = policy, N_ACTIONS

    def sent(observation):
        server._sent, server.last_processed_obs = None, SimpleNamespace(get_timestep=lambda: 0)
        return server._get_action_chunk(observation)

    earlier, now = (dict.fromkeys(STATE, torch.full((1, 6), value)) for value in (-1.0, 1.0))
    expected = sent(now)
    sent(earlier)
    assert torch.equal(sent(now), expected)
    assert expected.shape == (1, N_ACTIONS, 4)


def test_a_chunk_goes_on_from_the_one_before_until_it_can_arrive():
    policy = Case("arm", "act_chunked", STATE, {"execution": "crossfade"}).policy().eval()
    server = ChunkServer([], PolicyServerConfig())
    server.policy, server.actions_per_chunk, chunks = policy, 5, []
    for step, value in ((0, -1.0), (1, 1.0)):
        server.last_processed_obs = SimpleNamespace(get_timestep=lambda step=step: step)
        chunks.append(server._get_action_chunk(dict.fromkeys(STATE, torch.full((1, 6), value)))[0])
        server._seconds.append(0.9 / 30)
    alone = policy.predict_action_chunk(dict.fromkeys(STATE, torch.ones(1, 6)), inference_delay=0)[0]
    torch.testing.assert_close(chunks[1][:2], chunks[0][1:3])
    assert not torch.equal(chunks[1], alone)
    torch.testing.assert_close(chunks[1][-1], alone[-1])


@pytest.mark.parametrize("taken", [1, 2, 3])
def test_served_chunks_keep_to_speeds_whenever_they_arrive_in_time(taken):
    ones = torch.ones(4)
    limits = ActionLimits(
        "abcd", low=-9 * ones, high=9 * ones, change=0.1 * ones, scale=ones, offset=0 * ones
    )
    chunks = iter([torch.zeros(1, 12, 4), torch.full((1, 12, 4), 5.0)])
    known = SimpleNamespace(trained_on=SimpleNamespace(fps=30.0))
    server = ChunkServer([], PolicyServerConfig())
    server.policy = SimpleNamespace(
        limits=limits, config=known, predict_action_chunk=lambda _: next(chunks), reset=lambda: None
    )
    server.actions_per_chunk, sent = 12, []
    for step in (0, 4):
        server.last_processed_obs = SimpleNamespace(get_timestep=lambda step=step: step)
        sent.append(server._get_action_chunk({})[0])
        server._seconds.append(1.9 / 30)
    executed = torch.cat([sent[0][: 4 + taken], sent[1][taken:]])
    assert executed.diff(dim=0).abs().max() <= 0.1 + 1e-6
    assert executed[-1, 0] > 0.5
    assert limits.too_fast.sum() > 0
    server.Ready(None, SimpleNamespace(peer=lambda: "client"))
    assert server._sent is None


def test_settings_of_the_server_are_those_of_its_policies(checkpoints, capsys):
    path = checkpoints["act_chunked"]
    assert Served.of(path, ["smoothing_steps=3"]).config.smoothing_steps == 3
    with pytest.raises(ConfigurationError, match=r"does not take --policy\.colour=red"):
        Served.of(path, ["colour=red"])
    with pytest.raises(ConfigurationError, match="max_speed=-1"):
        Served.of(path, ["max_speed=-1"])


@pytest.mark.slow
def test_a_client_that_comes_back_goes_on(checkpoints, address):
    for _ in range(2):
        client = client_of(address, checkpoints["act_chunked"])
        assert client.start()
        assert len(act(client, N_ACTIONS)) == N_ACTIONS


@pytest.mark.slow
def test_the_arm_holds_while_the_server_is_away_and_goes_on_when_it_is_back(checkpoints):
    port, path = free_port(), checkpoints["act_chunked"]
    server = start([Served.of(path)], "127.0.0.1", port)
    client = client_of(f"127.0.0.1:{port}", path)
    assert client.start()
    act(client, N_ACTIONS)
    server.stop(None).wait()
    time.sleep(0.1)
    server = start([Served.of(path)], "127.0.0.1", port)
    again = client_of(f"127.0.0.1:{port}", path)
    assert again.start()
    assert len(act(again, N_ACTIONS)) == N_ACTIONS
    server.stop(None).wait()


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        (
            {"path": "/somewhere/else"},
            "/somewhere/else is not served: set --pretrained_name_or_path to one of",
        ),
        ({"policy_type": "act"}, "is of type act_chunked: set --policy_type=act_chunked, not act"),
        ({"camera": "front"}, "sees observation.images.top, but the robot has observation.images.front"),
        ({"joints": list(JOINTS[:5])}, "observation.state of 6 values, but the robot has 5 values"),
    ],
    ids=["another checkpoint", "another type", "another camera", "another arm"],
)
def test_a_client_that_does_not_fit_is_told_why(checkpoints, address, settings, reason, caplog):
    path = settings.pop("path", checkpoints["act_chunked"])
    client = client_of(address, path, **{"policy_type": "act_chunked", **settings})
    with caplog.at_level("ERROR"):
        assert not client.start()
    assert reason in caplog.text
    assert not client.robot.actions


def test_a_pickle_that_runs_code_is_refused_before_it_runs(address, tmp_path):
    import pickle

    from lerobot.transport import services_pb2, services_pb2_grpc

    class Evil:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "made"),)

    with grpc.insecure_channel(address) as channel:
        stub = services_pb2_grpc.AsyncInferenceStub(channel)
        stub.Ready(services_pb2.Empty())
        with pytest.raises(grpc.RpcError, match="mkdir, which is no part of an observation"):
            stub.SendPolicyInstructions(services_pb2.PolicySetup(data=pickle.dumps(Evil())))
        with pytest.raises(grpc.RpcError, match="7 bytes that cannot be read"):
            stub.SendPolicyInstructions(services_pb2.PolicySetup(data=b"garbage"))
    assert not (tmp_path / "made").exists()


def test_a_port_that_is_taken_is_refused(checkpoints, address):
    with pytest.raises(ConfigurationError, match="set another --port"):
        start([Served.of(checkpoints["act_chunked"])], "127.0.0.1", int(address.partition(":")[2]))


def test_a_checkpoint_that_lacks_a_file_is_refused_at_the_start(tmp_path):
    with pytest.raises(ConfigurationError, match="there is no checkpoint"):
        Served.of(str(tmp_path / "nothing"))


def test_nothing_is_written_where_the_command_runs(checkpoints, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    server = start([Served.of(checkpoints["act_chunked"])], "127.0.0.1", free_port())
    server.stop(None).wait()
    assert not list(tmp_path.iterdir())
