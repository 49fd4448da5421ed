"""Fast chunks: LeRobot's datasets, item for item, out of columnar memory.

LeRobot 0.6.1 converts every column of every row of a chunk through Python numbers, 6 ms for one sample of 100
steps. Here the numbers are arrays, read once, and a batch is gathered at once. The items are the same: keys
and their order, types, shapes, values, ``*_is_pad``, ``task``. Images and videos still come out of LeRobot's
own code.

**The seam.** ``install`` replaces two names in ``lerobot.datasets.factory``, the module from which
``lerobot-train`` gets its datasets, and nothing else:

- ``LeRobotDataset`` becomes ``FastChunkDataset``, a subclass that reads through ``ChunkReader``;
- ``make_dataset`` is wrapped to refuse an absent dataset and values that are not finite (see ``checks``).

LeRobot's classes stay as they are: whoever opens a ``LeRobotDataset`` to record, inspect or edit it is
unaffected, and ``FastChunkDataset`` can also be used directly. ``ACT_CHUNKING_FAST_CHUNKS=0`` leaves LeRobot
untouched. So does, with one line in the log, a LeRobot that differs from the one this was written for; and a
dataset whose first and last items do not come out as LeRobot's is read by LeRobot.
"""

from lerobot_act_chunking.data.fast_chunks.seam import install, uninstall

__all__ = ["install", "uninstall"]
