"""Run as a script: recordings that are killed with SIGKILL at chosen moments.

Each runs in a fork of this process, so that LeRobot is imported once. Arguments: the folder to work in, then
stories, each a name of ``MOMENTS`` or several joined by "+": a recording that is resumed and killed again.
The recording of a story goes to ``<folder>/<story>/data``. Prints nothing when each was killed.
"""

import os
import signal
import sys
from pathlib import Path
from pkgutil import resolve_name

from fake_source import FakeSource

from lerobot_act_chunking.executors.local import LocalWorker
from lerobot_act_chunking.recording import Target, record_source

EPISODES = 4
FAILING = (1,)

LEROBOT = "lerobot.datasets"
OURS = "lerobot_act_chunking.recording"

# moment: ((whose, function, the how manieth call, "before" or "after" it), workers, camera)
MOMENTS = {
    "staging_first_file": (("os", "fsync", 3, "before"), 1, False),
    "staging_third_file": (("os", "fsync", 7, "before"), 1, False),
    "three_staged": ((f"{OURS}.staging:EpisodeStore", "save", 3, "after"), 1, False),
    "lerobot_writes": (
        (f"{LEROBOT}.dataset_metadata:LeRobotDatasetMetadata", "save_episode", 2, "before"),
        1,
        False,
    ),
    "lerobot_wrote": ((f"{LEROBOT}.lerobot_dataset:LeRobotDataset", "save_episode", 3, "after"), 1, False),
    "closing_files": ((f"{LEROBOT}.lerobot_dataset:LeRobotDataset", "finalize", 1, "before"), 1, False),
    "before_publication": ((f"{OURS}.staging:Staging", "publish", 1, "before"), 1, False),
    "syncing_dataset": (("os", "fsync", 16, "before"), 1, False),
    "published": ((f"{OURS}.staging", "publish", 1, "after"), 1, False),
    "with_workers": ((f"{OURS}.attempts:AttemptQueue", "__next__", 3, "after"), 2, False),
    "encoding_video": (
        (f"{LEROBOT}.video_utils:StreamingVideoEncoder", "finish_episode", 2, "before"),
        1,
        True,
    ),
    "videos_done": ((f"{OURS}.staging:Staging", "publish", 1, "before"), 1, True),
}


def kill_at(whose, name, call, when):
    """Make the ``call``-th call of a function this process's last."""
    owner = resolve_name(whose)
    real = getattr(owner, name)
    calls = 0

    def wrapper(*args, **kwargs):
        nonlocal calls
        calls += 1
        if calls == call and when == "before":
            os.kill(os.getpid(), signal.SIGKILL)
        result = real(*args, **kwargs)
        if calls == call:
            os.kill(os.getpid(), signal.SIGKILL)
        return result

    setattr(owner, name, wrapper)


def note_workers(file):
    """Write down the workers' process ids."""
    start = LocalWorker.__init__

    def wrapper(self, *args):
        start(self, *args)
        with file.open("a") as out:
            out.write(f"{self.process.pid} ")

    LocalWorker.__init__ = wrapper


def record_until_killed(folder, moment):
    at, workers, camera = MOMENTS[moment]
    kill_at(*at)
    note_workers(folder / "workers")
    source = FakeSource(failing=FAILING, camera=camera, log=folder / "log")
    record_source(source, Target(folder / "data", "me/fake", EPISODES), workers=workers)


def main():
    resolve_name(f"{OURS}.assembly")  # imports LeRobot; at the top, every worker would do so as well
    base = Path(sys.argv[1])
    for story in sys.argv[2:]:
        (base / story).mkdir()
        for moment in story.split("+"):
            child = os.fork()
            if child == 0:
                record_until_killed(base / story, moment)
                os._exit(0)
            _, status = os.waitpid(child, 0)
            if not os.WIFSIGNALED(status) or os.WTERMSIG(status) != signal.SIGKILL:
                print(f"{story}: not killed at {moment}, status {status}")


if __name__ == "__main__":
    main()
