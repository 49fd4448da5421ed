"""Writing a policy's graph and description: complete, or not at all."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from act_chunking_runtime.files import DESCRIPTION, GRAPH, ActionSpec, Description
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.exporting.acting import acting_of
from lerobot_act_chunking.policies.exporting.network import ExportedNetwork
from lerobot_act_chunking.policies.exporting.onnx_graph import OPSET, check_opset, graph_of
from lerobot_act_chunking.policies.limits import action_names, scale_and_offset
from lerobot_act_chunking.policies.loading import LoadedPolicy
from lerobot_act_chunking.policies.saving import check_absent, save_checkpoint


@dataclass(frozen=True)
class Export:
    """A policy as it is written.

    Attributes:
        graph: in ONNX's format.
        description: all else.
    """

    graph: bytes
    description: Description

    def save_pretrained(self, folder: Path) -> None:
        """Write both, under the name that LeRobot has for this."""
        folder.mkdir(parents=True, exist_ok=True)
        (folder / GRAPH).write_bytes(self.graph)
        (folder / DESCRIPTION).write_text(self.description.text(), encoding="utf-8")


def export(loaded: LoadedPolicy, out: Path, opset: int = OPSET) -> Description:
    """Write a policy for `act_chunking_runtime.policy.load`.

    Args:
        loaded: on the CPU, with its processors.
        out: folder to make.
        opset: version of ONNX's operators.

    Raises:
        ConfigurationError: it cannot be exported, ``out`` exists, or the disk does not take it.
    """
    check_absent(out)
    check_opset(opset)
    policy = loaded.policy.eval()
    network = ExportedNetwork(policy, loaded.preprocessor, acting_of(policy)).eval()
    config = policy.config
    description = Description(
        policy_type=config.type,
        fps=None if config.trained_on is None else config.trained_on.fps,
        inputs=network.inputs,
        n_obs_steps=config.n_obs_steps,
        obs_stride=config.timing.obs_stride,
        draws=network.acting.draws,
        execution=config.execution_settings,
        actions=_actions(policy, loaded.postprocessor),
        opset=opset,
    )
    save_checkpoint([Export(graph_of(network, network.examples(), opset), description)], out)
    return description


def _actions(policy: Any, postprocessor: Any) -> ActionSpec:
    """What becomes of normalised actions.

    Raises:
        ConfigurationError: the postprocessor does more than to scale and shift them.
    """
    config = policy.config
    (n_dims,) = config.action_feature.shape
    units = scale_and_offset(postprocessor, n_dims, torch.float64)
    if units is None:
        raise ConfigurationError(
            "this checkpoint's postprocessor does more to actions than to scale and shift them, which is all "
            "that can be exported"
        )
    scale, offset = (each.tolist() for each in units)
    low, high, change = policy.limits.bounds if policy.limits is not None else (None, None, None)
    bounds = {"low": _given(low), "high": _given(high), "change": _given(change)}
    return ActionSpec(action_names(config), scale, offset, **bounds)


def _given(bound: np.ndarray | None) -> list[float] | None:
    """A limit that there is: of all dimensions, or of none."""
    return None if bound is None or np.isinf(bound).all() else bound.tolist()
