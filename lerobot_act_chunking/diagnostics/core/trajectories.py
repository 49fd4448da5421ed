"""Motions as arrays, and what is said where one does not define a measure."""

from collections.abc import Sequence

import numpy as np

Trajectories = Sequence[np.ndarray]
"""``(T, D)`` each, one row per control step."""
JITTER_HZ = 5.0
"""Frequency above which people do not move a robot on purpose."""


class UndefinedMeasureError(ValueError):
    """The data do not define this measure; the message says why."""
