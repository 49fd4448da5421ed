"""Smoothing each chunk before it is executed."""

from collections.abc import Sequence

import numpy as np


def moving_mean(chunk: np.ndarray, steps: int, gripper_dims: Sequence[int] = ()) -> np.ndarray:
    """Each action replaced by the mean of the ``steps`` actions around it.

    Errors that are independent from step to step keep a ``steps``-th of their variance. The mean is centred,
    so that the motion is not delayed. Beyond its ends a chunk is continued by its first and its last action.

    Args:
        chunk: the predicted actions (..., T, A).
        steps: how many are averaged [control steps], an odd number; 1 changes nothing.
        gripper_dims: action dimensions that stay as they are.
    """
    if steps == 1:
        return chunk
    half = steps // 2
    first, last = (np.repeat(end, half, axis=-2) for end in (chunk[..., :1, :], chunk[..., -1:, :]))
    padded = np.concatenate([first, chunk, last], axis=-2)
    smooth = np.lib.stride_tricks.sliding_window_view(padded, steps, axis=-2).mean(-1, dtype=chunk.dtype)
    held = list(gripper_dims)
    smooth[..., held] = chunk[..., held]
    return smooth
