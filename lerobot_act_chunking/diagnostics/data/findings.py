"""Everything that was measured of a dataset."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lerobot_act_chunking.diagnostics.core.noise_floor import NoiseFloor
from lerobot_act_chunking.diagnostics.core.stillness import Rests, Stillness
from lerobot_act_chunking.diagnostics.core.tracking import Tracking
from lerobot_act_chunking.diagnostics.data.cameras import Camera
from lerobot_act_chunking.diagnostics.data.clocks import Clock
from lerobot_act_chunking.diagnostics.data.dimensions import Behaviour, Repeats
from lerobot_act_chunking.diagnostics.data.operators import Split
from lerobot_act_chunking.diagnostics.data.ways import Ways


@dataclass(frozen=True)
class Motion:
    """What the actions do, or the states.

    Attributes:
        floor: which dimensions move.
        behaviours: of each dimension.
        stillness: of each episode.
        rests: of all together.
        repeats: rows that equal the one before.
    """

    floor: NoiseFloor
    behaviours: list[Behaviour]
    stillness: list[Stillness]
    rests: Rests
    repeats: Repeats

    @property
    def jump_frames(self) -> int:
        """Frames with a jump of a dimension that moves."""
        return len({place for each in self.behaviours if each.moves for place in each.jumps})

    @property
    def paces(self) -> list[float]:
        """Of each episode: median speed in motion [standard deviations per second]."""
        return [each.pace for each in self.stillness]


@dataclass(frozen=True)
class Findings:
    """Of a whole dataset.

    Attributes:
        lengths_s: of each episode.
        broken: episodes that hold a NaN or an infinity; nothing else is measured of them.
        clocks: columns with times.
        actions: what is commanded.
        states: what is observed; None without states.
        tracking: lags of the states behind the actions.
        pair_note: how actions and states belong together, where their names do not tell.
        changes: whether actions are changes of the state, not positions (`asks_for_changes`).
        ways: groups of demonstrations.
        cameras: what they show.
        operators: episodes by who demonstrates; empty where nobody is named.
        split: training and validation by different people, if there are two.
    """

    lengths_s: Sequence[float]
    broken: dict[int, list[str]]
    clocks: list[Clock]
    actions: Motion
    states: Motion | None
    tracking: Tracking
    pair_note: str | None
    changes: bool
    ways: Ways
    cameras: list[Camera]
    operators: dict[str, int]
    split: Split | None

    @property
    def longest_lag_s(self) -> float:
        """Of all dimensions whose lag is known; 0 if none is."""
        return max((lag.seconds for lag in self.tracking.joints.values() if lag is not None), default=0.0)

    @property
    def pace_spread(self) -> float:
        """How many times as fast as the slow tenth of the episodes the fast tenth moves."""
        slow, fast = np.percentile([pace for pace in self.actions.paces if pace > 0] or [1.0], [10, 90])
        return float(fast / slow)
