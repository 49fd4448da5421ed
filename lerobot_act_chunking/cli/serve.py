"""``act-chunking serve``: a policy on one machine, the robot on another."""

from importlib.util import find_spec
from typing import Annotated

import typer

from lerobot_act_chunking.cli.environment import EnvironmentCommand
from lerobot_act_chunking.cli.options import PolicyFields

CLIENT = "python -m lerobot.async_inference.robot_client"


class PolicyCommand(EnvironmentCommand):
    """A command whose ``--policy.FIELD`` come to it as ``FIELD=VALUE``."""

    prefix = "--policy."


def serve_command(
    checkpoints: Annotated[
        list[str],
        typer.Argument(
            help="Checkpoint folders (…/pretrained_model) or repo ids: clients may ask for these."
        ),
    ],
    host: Annotated[
        str, typer.Option(help="Address to listen at; 0.0.0.0 is all of this machine's.")
    ] = "127.0.0.1",
    policy: PolicyFields = None,
    port: Annotated[int, typer.Option(min=1, max=65535, help="Port to listen at.")] = 8080,
) -> None:
    """Let policies of every installed type act through LeRobot's robot client, over a network.

    The client is LeRobot 0.6's own, unchanged. Stop it with Ctrl-C: the robot then holds its last position.
    """
    from lerobot_act_chunking.errors import ConfigurationError

    if find_spec("lerobot.async_inference") is None:
        raise ConfigurationError(
            "this LeRobot has a server of its own, which takes the types of plug-ins: lerobot-policy-server "
            "--help"
        )
    _run(checkpoints, tuple(policy or ()), host, port)


def _run(checkpoints: list[str], settings: tuple[str, ...], host: str, port: int) -> None:
    from rich.console import Console

    from lerobot_act_chunking.policies.execution_fields import ExecutionFields
    from lerobot_act_chunking.serving.server import LOOPBACK, Served, start

    console = Console(highlight=False, soft_wrap=True)
    served = [Served.of(path, settings) for path in checkpoints]
    server = start(served, host, port)
    if host not in LOOPBACK:
        console.print(
            f"[yellow]whoever reaches {host}:{port} can use these policies.[/] LeRobot's protocol is neither "
            "encrypted nor signed, and carries pickles: this server builds nothing of them but observations, "
            "but a client runs whatever a server sends it. Use it in a network that you trust, or through a "
            f"tunnel: ssh -L {port}:127.0.0.1:{port}"
        )
    console.print(f"listening at {host}:{port}")
    for each in served:
        kind = each.config.type
        # Mixed with older ones, chunks that continue what was sent before would leap.
        mixing = "--aggregate_fn_name=latest_only " if isinstance(each.config, ExecutionFields) else ""
        console.print(
            f"{kind}: {CLIENT} --server_address={host}:{port} --policy_type={kind} "
            f"--pretrained_name_or_path={each.path} --actions_per_chunk={_actions(each.config)} "
            f"{mixing}--robot.type=..."
        )
    try:
        server.wait_for_termination()
    finally:
        server.stop(grace=1).wait()


def _actions(config: object) -> int:
    """How many actions of a chunk are worth sending."""
    steps = getattr(config, "n_action_steps", None) or getattr(config, "chunk_size", None)
    return int(steps or 1)
