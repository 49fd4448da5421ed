"""Fast chunks: LeRobot's datasets, item for item, out of columnar memory.

LeRobot 0.6.1 converts every column of every row of a chunk through Python numbers, 6 ms for one sample of 100
steps. Here the numbers are arrays, read once, and a batch is gathered at once. The items are the same: keys
and their order, types, shapes, values, ``*_is_pad``, ``task``. Images and videos still come out of LeRobot's
own code; what it decoded of a video is kept on the disk, at the size that a policy asks for (see ``frames``).

**Where it enters LeRobot.** ``install`` replaces three names in ``lerobot.datasets.factory``, the module from
which ``lerobot-train`` gets its datasets, and nothing else:

- ``LeRobotDataset`` becomes ``FastChunkDataset``, a subclass that reads through ``ChunkReader``;
- ``make_dataset`` is wrapped to refuse an absent dataset (see ``checks``);
- ``resolve_delta_timestamps`` is wrapped to tell the reader what a policy reads (see ``reading``): that alone
  is checked (see ``rows``) and decoded.

The last two concern this package's policies. For LeRobot's own nothing changes, errors included.

LeRobot's classes stay as they are: whoever opens a ``LeRobotDataset`` to record, inspect or edit it is
unaffected, and ``FastChunkDataset`` can also be used directly. ``ACT_CHUNKING_FAST_CHUNKS=0`` leaves LeRobot
untouched. So does, with one line in the log, a LeRobot that differs from the one this was written for; and a
dataset whose first and last items do not come out as LeRobot's, or at which the reader fails, is left to
LeRobot.
"""

from lerobot_act_chunking.data.fast_chunks.factory_patch import install, uninstall

__all__ = ["install", "uninstall"]
