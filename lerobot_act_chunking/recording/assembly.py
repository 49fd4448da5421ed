"""Putting finished episodes together with LeRobot's own writer; the one module here that imports LeRobot."""

import json
import shutil
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

import av.logging
from lerobot.configs import RGBEncoderConfig
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.datasets.utils import STATS_PATH
from lerobot.utils.utils import SuppressProgressBars

from lerobot_act_chunking.errors import DatasetError
from lerobot_act_chunking.recording.episode import DatasetFormat, Episode
from lerobot_act_chunking.recording.summary import SUMMARY_PATH

# LeRobot's default, AV1, takes four times as long and talks on stderr. With B-frames and macroblock trees,
# x264's lookahead makes different files of the same frames now and then; groups of two frames need neither.
_VIDEO_ENCODER = RGBEncoderConfig(
    vcodec="h264", crf=23, preset="veryfast", extra_options={"bf": "0", "x264-params": "mbtree=0"}
)
# LeRobot's encoder drops frames when its queue is full, so it must hold the longest episode.
_FRAME_QUEUE = 100_000


class DatasetAssembly:
    """A LeRobotDataset in the making: ``add`` episodes in order, then ``finish``.

    A context manager: leaving it on an error removes the folder. Equal episodes give equal files.

    Args:
        folder: where to make it; what an earlier attempt left there is removed.
        repo_id: name for LeRobot.
        form: features, rate and task.
    """

    def __init__(self, folder: Path, repo_id: str, form: DatasetFormat) -> None:
        self._folder, self._repo_id, self._form = folder, repo_id, form
        self._lengths: list[int] = []
        # At the last moment: an encoder of a failed attempt in this process may write for a while.
        shutil.rmtree(folder, ignore_errors=True)
        self._dataset = LeRobotDataset.create(
            repo_id=repo_id,
            fps=form.fps,
            features={name: dict(entry) for name, entry in form.features.items()},
            root=folder,
            robot_type=form.robot_type,
            use_videos=bool(form.videos),
            video_backend="pyav",  # naming it keeps LeRobot from probing, and warning about, torchcodec
            rgb_encoder=_VIDEO_ENCODER,
            streaming_encoding=True,
            encoder_queue_maxsize=_FRAME_QUEUE,
            encoder_threads=1,  # H.264 splits frames by threads: one thread, one result on every machine
        )

    def add(self, episode: Episode) -> None:
        """Append one episode."""
        videos = {name: video.frames() for name, video in episode.videos.items()}
        for t in range(len(episode)):
            frame: dict[str, Any] = {name: array[t] for name, array in episode.arrays.items()}
            frame |= {name: next(video) for name, video in videos.items()}
            self._dataset.add_frame({**frame, "task": episode.task or self._form.task})
        with SuppressProgressBars():
            self._dataset.save_episode()
        self._lengths.append(len(episode))

    def finish(self, summary: dict[str, Any]) -> None:
        """Complete the files, with ``summary`` as ``meta/recording.json``, and check that LeRobot reads them.

        Raises:
            DatasetError: a video lost frames.
        """
        self._dataset.finalize()
        (self._folder / SUMMARY_PATH).write_text(json.dumps(summary, indent=2))
        # LeRobot writes the statistics in the order of a set, another one in every process.
        stats = self._folder / STATS_PATH
        stats.write_text(json.dumps(json.loads(stats.read_text()), indent=4, sort_keys=True))
        self._check_videos()

    def _check_videos(self) -> None:
        episodes: Any = LeRobotDatasetMetadata(self._repo_id, root=self._folder).episodes
        for name in self._form.videos:
            starts, ends = (episodes[f"videos/{name}/{side}_timestamp"] for side in ("from", "to"))
            for index, (start, end, length) in enumerate(zip(starts, ends, self._lengths, strict=True)):
                frames = (end - start) * self._form.fps
                if abs(frames - length) > 0.5:
                    raise DatasetError(
                        f"the video {name} of episode {index} has {frames:.0f} of {length} frames"
                    )

    def __enter__(self) -> Self:
        # LeRobot's encoder turns FFmpeg's own printing back on: twenty lines an episode at the usual level.
        av.logging.set_libav_level(av.logging.ERROR)
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            for stop in (self._dataset.clear_episode_buffer, self._dataset.finalize):
                with suppress(Exception):  # the error that brought us here is the one to report
                    stop()
            shutil.rmtree(self._folder, ignore_errors=True)
        av.logging.set_libav_level(av.logging.INFO)
