"""Training on several processes: together they compute what one would on the batches of all.

Each has a batch of the same size, whose samples are the next ones after those of the process before it.
"""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from jaxtyping import Shaped
from torch import Tensor


def is_distributed() -> bool:
    """Whether this process is one of several that train together."""
    return torch.distributed.is_available() and torch.distributed.is_initialized()


def draw_rows(draw: Callable[..., Tensor], shape: Sequence[int], **how: Any) -> Tensor:
    """Random numbers for the samples of this process: its rows of what one process would draw for all.

    Args:
        draw: `torch.rand`, `torch.randn`, or another that takes a shape first.
        shape: (B, ...) for this process's samples.
        how: further arguments, as ``generator``, which has the same state in all processes.
    """
    if not is_distributed():
        return draw(shape, **how)
    n_rows, *rest = shape
    return own_rows(draw((torch.distributed.get_world_size() * n_rows, *rest), **how))


def own_rows(rows: Shaped[Tensor, "N *S"]) -> Shaped[Tensor, "B *S"]:
    """Of the rows of all processes those of this one."""
    if not is_distributed():
        return rows
    return rows.chunk(torch.distributed.get_world_size())[torch.distributed.get_rank()]


def all_rows(rows: Shaped[Tensor, "B *S"]) -> Shaped[Tensor, "N *S"]:
    """The rows of all processes, which gradients pass; all of them must call this."""
    if not is_distributed():
        return rows
    from torch.distributed.nn.functional import all_gather  # there is none where nothing is distributed

    return torch.cat(all_gather(rows.contiguous()))


def mean_over_processes(value: Tensor) -> Tensor:
    """The mean of a batch's statistic over the batches of all processes; all of them must call this."""
    if not is_distributed():
        return value
    total = value.detach().float().clone()
    torch.distributed.all_reduce(total)
    return total / torch.distributed.get_world_size()


def counted_together(count: Tensor) -> Tensor:
    """What a loss is divided by: the mean of all processes' counts, where there are gradients to average.

    Processes average their losses and gradients. If each divided its sum by a count of its own (of the steps
    that are not padded, say), their samples would weigh differently; divided by the mean of the counts, the
    average is the sum of all over the count of all.
    """
    return mean_over_processes(count) if torch.is_grad_enabled() else count


def of_first_process(number: int) -> int:
    """What the first process has, in all."""
    numbers = [number]
    if is_distributed():
        torch.distributed.broadcast_object_list(numbers, src=0)
    return numbers[0]
