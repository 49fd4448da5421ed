"""A module as an ONNX graph, by PyTorch's exporter."""

import logging
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from act_chunking_runtime.files import CHUNK
from lerobot_act_chunking.errors import ConfigurationError, need
from lerobot_act_chunking.policies.exporting.elementary import next_below, normal_quantile, stable_sort

EXTRA = "lerobot_policy_act_chunking[export]"
ASKED = "act-chunking export"
OPSET = 20
OPSETS = range(18, 24)  # what PyTorch's exporter writes; ONNX Runtime reads all of them
TOLERANCE = 1e-4  # of the largest normalised action, or of 1; what is right differs by a hundredth of it
_WRITTEN_OUT: dict[Any, Any] = {
    torch.ops.aten.special_ndtri.default: normal_quantile,
    torch.ops.aten.nextafter.default: next_below,
    torch.ops.aten.sort.stable: stable_sort,
}
"""By the operator that ONNX does not have."""


def check_opset(opset: int) -> None:
    """Refuse what PyTorch's exporter does not write, and a missing package.

    Raises:
        ConfigurationError: with the range, or with the command that installs the package.
    """
    if opset not in OPSETS:
        raise ConfigurationError(
            f"--opset={opset} is none that PyTorch writes and ONNX Runtime reads: give one from {OPSETS[0]} "
            f"to {OPSETS[-1]}"
        )
    need("onnx", ASKED, EXTRA)
    need("onnxruntime", ASKED, EXTRA)
    need("onnxscript", ASKED, EXTRA)


def graph_of(network: nn.Module, examples: Mapping[str, Tensor], opset: int) -> bytes:
    """The graph of a module in evaluation mode, whose inputs are ``examples`` in this order.

    Raises:
        ConfigurationError: ONNX Runtime computes something else from it than PyTorch does.
    """
    inputs = tuple(examples.values())
    with _quietly(), _fixed_counters(network), torch.no_grad():
        expected = network(*inputs)
        program = torch.export.export(network, inputs, strict=False).run_decompositions(_WRITTEN_OUT)
        exported = torch.onnx.export(
            program,
            dynamo=True,
            verbose=False,
            input_names=list(examples),
            output_names=[CHUNK],
            opset_version=opset,
        )
    graph = _without_traces(exported.model_proto)  # pyright: ignore[reportOptionalMemberAccess]
    check_graph(graph, examples, expected.numpy())
    return graph


def check_graph(graph: bytes, examples: Mapping[str, Tensor], expected: np.ndarray) -> None:
    """Refuse a graph that computes something else than PyTorch does.

    Raises:
        ConfigurationError: with the largest difference, as a share of the largest action.
    """
    onnxruntime = need("onnxruntime", ASKED, EXTRA)
    session = onnxruntime.InferenceSession(graph, providers=["CPUExecutionProvider"])
    (chunks,) = session.run([CHUNK], {name: value.numpy() for name, value in examples.items()})
    difference = np.abs(chunks - expected).max() / max(1.0, np.abs(expected).max())
    if not difference <= TOLERANCE:
        raise ConfigurationError(
            f"the graph's chunks differ from PyTorch's by {difference:.1e} of the largest action, more than "
            f"{TOLERANCE:g}: nothing was written; another --opset may help"
        )


def _without_traces(model: Any) -> bytes:
    """The graph without what the exporter notes of the source code, its paths among them."""
    for node in (*model.graph.node, *(node for each in model.functions for node in each.node)):
        del node.metadata_props[:]
        node.doc_string = ""
    for part in (model, model.graph, *model.graph.value_info, *model.graph.input, *model.graph.output):
        del part.metadata_props[:]
    for function in model.functions:
        del function.metadata_props[:]
    return model.SerializeToString()


@contextmanager
def _fixed_counters(network: nn.Module) -> Iterator[None]:
    """With the training steps that modules count as plain numbers, which they decide by."""
    counters = [
        (module, name, value)
        for module in network.modules()
        for name, value in module._buffers.items()
        if value is not None and not value.ndim and not value.is_floating_point()
    ]
    for module, name, value in counters:
        del module._buffers[name]
        setattr(module, name, value.item())
    try:
        yield
    finally:
        for module, name, value in counters:
            delattr(module, name)
            module._buffers[name] = value


@contextmanager
def _quietly() -> Iterator[None]:
    """Without what the exporter says of its own progress and its own code."""
    level = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(level)
