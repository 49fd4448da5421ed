"""Which of several equally valid ways an episode went: told by where the cube changes hands."""

from collections.abc import Sequence

import numpy as np

from lerobot_act_chunking.envs.aloha.rewards import CUBE, TABLE, Contacts
from lerobot_act_chunking.envs.aloha.success import touching

TOLERANCE = 0.05
"""How far [m] from its place a hand-over still counts as this one; no point is so near to two places."""


class HandOverMode:
    """Tells an episode's way, once, by the cube's position when both arms first touch it off the table.

    Args:
        places: (x, y, z) [m] of each way's hand-over.
    """

    def __init__(self, places: Sequence[tuple[float, float, float]]) -> None:
        self._places = np.asarray(places)
        self.reset()

    def reset(self) -> None:
        """Start a new episode."""
        self._handed_over = False
        self.mode = -1

    def update(self, contacts: Contacts, cube: np.ndarray) -> None:
        """Take in one control step: the touching geoms and where the cube (3,) is [m]."""
        if self._handed_over or not _in_both_hands(contacts):
            return
        self._handed_over = True
        distances = np.linalg.norm(self._places - cube, axis=1)
        if distances.min() <= TOLERANCE:
            self.mode = int(distances.argmin())


def _in_both_hands(contacts: Contacts) -> bool:
    geoms = touching(contacts, {CUBE})
    sides = {geom.partition("/")[0] for geom in geoms}
    return {"vx300s_left", "vx300s_right"} <= sides and TABLE not in geoms
