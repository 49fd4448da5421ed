"""Chunks of demonstrated actions, and what a tokenizer makes of them."""

from dataclasses import dataclass

import numpy as np

from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes, evenly
from lerobot_act_chunking.diagnostics.core.noise_floor import measure_noise
from lerobot_act_chunking.errors import DatasetError

MOST_CHUNKS = 10_000


@dataclass(frozen=True)
class DemonstratedChunks:
    """Chunks in raw units, with where they come from.

    Attributes:
        actions: (N, C, A); padded steps repeat the episode's last action.
        is_pad: (N, C) steps behind the end of the episode.
        episode: (N,) its number.
        step: (N,) first control step, counted from the episode's first.
        progress: (N,) the same from 0 to 1 over the episode.
        control_steps: what a chunk covers.
        moving: (A,) whether the dimension moves in these demonstrations; the others are in no verdict.
    """

    actions: np.ndarray
    is_pad: np.ndarray
    episode: np.ndarray
    step: np.ndarray
    progress: np.ndarray
    control_steps: int
    moving: np.ndarray

    def __len__(self) -> int:
        return len(self.actions)


@dataclass(frozen=True)
class CodedChunks:
    """Chunks with their codes.

    Attributes:
        chunks: as demonstrated.
        codes: (N, G).
        decoded: (N, C, A), what the codes alone stand for, in raw units.
        lost: (N, A) squared error of each chunk, mean over its valid steps, in normalised units.
        varies: (A,) variance of all chunks' valid steps in these units.
    """

    chunks: DemonstratedChunks
    codes: np.ndarray
    decoded: np.ndarray
    lost: np.ndarray
    varies: np.ndarray

    @property
    def errors(self) -> np.ndarray:
        """Absolute errors (N, C, A) in raw units; NaN for padded steps."""
        absolute = np.abs(self.decoded - self.chunks.actions)
        return np.where(self.chunks.is_pad[..., None], np.nan, absolute)

    @property
    def chunk_errors(self) -> np.ndarray:
        """RMS error (N,) of each chunk over valid steps and dimensions that move, in normalised units."""
        return self.errors_of(self.chunks.moving)

    def errors_of(self, dims: np.ndarray) -> np.ndarray:
        """The same (N,) over the dimensions of a mask (A,)."""
        return np.sqrt(self.lost[:, dims].mean(1)) if dims.any() else np.zeros(len(self.lost))

    @property
    def lost_variance(self) -> np.ndarray:
        """Share (A,) of each dimension's variance that the codes lose; NaN where nothing moves.

        Codes that are farther off than the mean have lost all of it: 1.
        """
        known = self.chunks.moving & (self.varies > 0)
        shares = self.lost.mean(0) / np.where(known, self.varies, 1)
        return np.where(known, shares.clip(max=1.0), np.nan)


def cut_chunks(
    demonstrations: ActionEpisodes, timing: ChunkTiming, most: int = MOST_CHUNKS
) -> DemonstratedChunks:
    """The chunk that begins at each control step, evenly thinned out where there are more than ``most``.

    Chunks of which more than half would be padding are left out: tokenizers learn nothing from them.

    Raises:
        DatasetError: no episode is half as long as a chunk.
    """
    offsets = np.arange(timing.chunk_size) * timing.chunk_stride
    needed = offsets[(timing.chunk_size - 1) // 2]  # the last step that must still be in the episode
    starts = [
        np.stack([np.full(n, episode), np.arange(n)], axis=1)
        for episode, actions in demonstrations.episodes.items()
        if (n := len(actions) - needed) > 0
    ]
    if not starts:
        raise DatasetError(
            f"no episode of {demonstrations.folder} is half as long as a chunk of {timing.control_steps} "
            "control steps: choose a shorter chunk_size or chunk_stride"
        )
    rows = np.concatenate(starts)
    episode, step = rows[evenly(len(rows), most)].T
    lengths = np.array([len(demonstrations.episodes[each]) for each in episode])
    steps = step[:, None] + offsets
    held = np.minimum(steps, lengths[:, None] - 1)
    actions = np.stack([demonstrations.episodes[e][rows] for e, rows in zip(episode, held, strict=True)])
    return DemonstratedChunks(
        actions=actions.astype(np.float32),
        is_pad=steps >= lengths[:, None],
        episode=episode,
        step=step,
        progress=step / np.maximum(lengths - 1, 1),
        control_steps=timing.control_steps,
        moving=_moving(demonstrations),
    )


def _moving(demonstrations: ActionEpisodes) -> np.ndarray:
    """Mask (A,) of the dimensions that move; of all that change, if none stands out of its noise."""
    floor = measure_noise(list(demonstrations.episodes.values()), demonstrations.fps, demonstrations.names)
    kinds = np.array([dimension.kind for dimension in floor.dimensions])
    return kinds == "moves" if floor.moving else kinds != "constant"
