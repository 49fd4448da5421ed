"""``act-chunking export``: a policy for a robot that has neither PyTorch nor LeRobot."""

from pathlib import Path
from typing import Annotated

import typer

from lerobot_act_chunking.cli.options import OUT, PolicyFields


def export_command(
    path: Annotated[str, typer.Argument(help="Checkpoint folder (…/pretrained_model) or repo id.")],
    out: Annotated[Path, typer.Option(*OUT, help="The folder to write; must not exist.")],
    opset: Annotated[int, typer.Option(help="Version of ONNX's operators, 18 to 23.")] = 20,
    policy: PolicyFields = None,
) -> None:
    """Write a checkpoint as an ONNX graph and a JSON file, which act with NumPy and ONNX Runtime alone.

    The graph normalises, predicts and interpolates; the file has the execution of chunks, the action's units
    and limits, and the random numbers that the robot draws. docs/guides/export.md has the robot's loop.
    """
    _run(path, out, opset, tuple(policy or ()))


def _run(path: str, out: Path, opset: int, settings: tuple[str, ...]) -> None:
    from rich.console import Console

    from lerobot_act_chunking.policies.exporting.acting import check_type
    from lerobot_act_chunking.policies.exporting.export import export
    from lerobot_act_chunking.policies.exporting.onnx_graph import check_opset
    from lerobot_act_chunking.policies.loading import load_policy, read_config
    from lerobot_act_chunking.policies.saving import check_absent

    check_absent(out)
    check_opset(opset)
    check_type(read_config(path, settings).type)
    description = export(load_policy(path, (*settings, "device=cpu")), out, opset)
    console = Console(highlight=False, soft_wrap=True)
    inputs = ", ".join(f"{key} {spec.dtype} {spec.shape}" for key, spec in description.inputs.items())
    settled = description.execution
    console.print(
        f"exported: {description.policy_type}, {settled.n_action_steps} actions of each chunk, "
        f"execution={settled.execution}, a new chunk every {settled.replan_interval} steps"
    )
    console.print(f"it reads: {inputs}")
    console.print(f"folder: {out}")
    console.print("on the robot: pip install onnxruntime, and docs/guides/export.md")
