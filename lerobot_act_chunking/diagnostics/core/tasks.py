"""Tasks of a measurement, each with its share of the cores."""

import os
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from functools import partial

from lerobot_act_chunking.executors import Cluster, Executor, Open, Places, open_executor


def open_tasks[T, A](
    open_: Open[T, A], workers: int, cluster: Cluster | None = None, folders: Collection[str] = ()
) -> Executor[T, A]:
    """As `open_executor`, with policies that leave cores to the other workers."""
    if workers > 1 or cluster is not None:
        threads = 1 if cluster is not None else max(1, (os.cpu_count() or 1) // workers)
        open_ = partial(_with_threads, open_, threads)
    return open_executor(open_, workers, cluster, folders)


@contextmanager
def _with_threads[T, A](open_: Open[T, A], threads: int, places: Places) -> Iterator[Callable[[T], A]]:
    import torch

    torch.set_num_threads(threads)
    with open_(places) as answer:
        yield answer
