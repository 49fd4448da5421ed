"""Which workers do the work: this process, processes of this machine, or those of a cluster."""

from collections.abc import Collection
from dataclasses import dataclass
from functools import partial

from lerobot_act_chunking.executors.executor import Executor, Inline, Open, Workers
from lerobot_act_chunking.executors.local import LocalWorker


@dataclass(frozen=True)
class Cluster:
    """A Ray cluster.

    Attributes:
        address: as Ray understands it, ``HOST:PORT``, ``auto`` or ``ray://HOST:PORT``; None for a Ray of this
            machine, which ends with this process.
    """

    address: str | None = None

    def connect(self, workers: int | None = None) -> int:
        """Connect this process, which stays connected; how many workers there are.

        Args:
            workers: how many are wanted; None for one on each CPU.

        Raises:
            ConfigurationError: Ray is not installed, or there is no cluster at the address.
        """
        from lerobot_act_chunking.executors.ray import connect

        return connect(self.address, workers)


def open_executor[T, A](
    open_: Open[T, A], workers: int, cluster: Cluster | None = None, folders: Collection[str] = ()
) -> Executor[T, A]:
    """What does items with so many workers; one of this machine is this process.

    Results depend on the items alone: not on the workers, their number, or where they are.

    Args:
        open_: prepares a worker.
        workers: how many.
        cluster: whose; None for this machine's.
        folders: that workers on other machines need, by their paths here.

    Raises:
        ConfigurationError: as of `Cluster.connect`.
    """
    if cluster is not None:
        from lerobot_act_chunking.executors.ray import make_worker

        cluster.connect(workers)
        return Workers(make_worker(open_, folders), workers)
    if workers == 1:
        return Inline(open_)
    return Workers(partial(LocalWorker, open_), workers)
