"""Everything the diagnosis found, as one object: the command prints it, JSON holds it, plots draw it."""

from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import numpy as np

from lerobot_act_chunking.diagnostics.core.noise_floor import NoiseFloor
from lerobot_act_chunking.diagnostics.core.report import Report
from lerobot_act_chunking.diagnostics.replay.execution import Gripper, Hesitations
from lerobot_act_chunking.diagnostics.replay.horizon import Following, Horizon
from lerobot_act_chunking.diagnostics.replay.settings import Settings


@dataclass(frozen=True)
class Drawn:
    """Chunks along one episode.

    Attributes:
        episode: its number.
        done: (L, A) what was demonstrated.
        at: (N,) steps at which chunks begin.
        chunks: (N, T, A).
    """

    episode: int
    done: np.ndarray
    at: np.ndarray
    chunks: np.ndarray


@dataclass(frozen=True, kw_only=True)
class ReplayReport(Report):
    """The answer to: what would this policy do where the demonstrators were?

    Attributes:
        requested: what was asked.
        policy_type: of the checkpoint.
        fps: control steps per second.
        names: of the action's dimensions.
        episodes: that were replayed.
        learned: those among them that the policy was trained on.
        n_observations: at which it was asked for a whole chunk.
        spread: standard deviation (A,) of the dataset's actions.
        floor: which dimensions move.
        horizon: errors by step.
        following: whether chunks follow the demonstrator; None where nothing moves.
        grippers: when they switch.
        hesitations: who stands still where the other moves; None where nothing moves.
        people: mean errors by person, where the recording knows them.
        drawn: for the picture.
    """

    tool: ClassVar[str] = "replay"
    requested: Settings
    policy_type: str
    fps: float
    names: list[str]
    episodes: list[int]
    learned: list[int]
    n_observations: int
    spread: np.ndarray
    floor: NoiseFloor
    horizon: Horizon
    following: Following | None
    grippers: list[Gripper]
    hesitations: Hesitations | None
    people: dict[str, dict[str, Any]]
    drawn: Drawn

    @property
    def which(self) -> str:
        """Which episodes were replayed, and whether the policy knows them, in a sentence."""
        n = len(self.episodes)
        if not self.learned:
            return f"{n} episodes that its training did not use, as far as the checkpoint tells"
        return f"{n} episodes, {len(self.learned)} of which it has learned from"

    def content(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dictionaries; None for what was not or cannot be measured."""
        found = self.following
        return {
            "checkpoint": self.requested.checkpoint,
            "policy_type": self.policy_type,
            "dataset": self.requested.dataset,
            "fps": self.fps,
            "episodes": self.episodes,
            "learned": self.learned,
            "n_observations": self.n_observations,
            "seed": self.requested.seed,
            "verdict": self.verdict,
            "reasons": self.reasons,
            "following": found and {**asdict(found), "outside": found.outside.tolist()},
            "grippers": [asdict(each) for each in self.grippers],
            "hesitations": self.hesitations and asdict(self.hesitations),
            "people": self.people,
            "dimensions": [
                {**kind, "std": float(self.spread[dim]), "median": _column(self.horizon.median, dim)}
                | {"p90": _column(self.horizon.p90, dim)}
                for dim, kind in enumerate(self.floor.to_json())
            ],
        }


def _column(errors: dict[str, np.ndarray], dim: int) -> dict[str, list[float | None]]:
    """Errors of one dimension by step; None where every episode has ended."""
    return {
        name: [None if np.isnan(each) else float(each) for each in found[:, dim]]
        for name, found in errors.items()
    }
