"""The mode of PyTorch in which policies act."""

import functools
from collections.abc import Callable

import torch


def acting[**P, R](function: Callable[P, R]) -> Callable[P, R]:
    """Run a method without gradients and never in inference mode, whatever the caller's mode is.

    Tensors that are made in inference mode can neither be written to nor trained with outside of it. A policy
    keeps some from call to call: plans, histories and whatever its network computes once. They would fail
    after an evaluation under ``torch.inference_mode()``, as LeRobot's is, when training goes on.
    """

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        with torch.inference_mode(False), torch.no_grad():
            return function(*args, **kwargs)

    return call
