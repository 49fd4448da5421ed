"""Demonstrations of paths to two or three goals, and which of them a sampled chunk follows."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

LENGTH, CHUNK = 25, 20
"""Steps of a path, and actions of a chunk: the first four fifths of it."""
BOW, NOISE = 0.15, 0.02
"""How far paths bend, and how much ends and bends vary; the goals are at distance 1."""
VALID = 0.2
"""RMS distance from the nearest expert's path up to which a chunk is one."""
COVERED = 0.25
"""Share of its share in the demonstrations from which a mode counts as covered."""

Batch = dict[str, Tensor]


@dataclass(frozen=True)
class Planted:
    """What is demonstrated.

    Attributes:
        shares: of the episodes, for each goal. The goals are evenly spaced on a circle around the start and
            their paths are each other's rotations, so that no mode lies between two others.
        episodes: how many.
    """

    shares: tuple[float, ...]
    episodes: int = 100

    @property
    def name(self) -> str:
        """For people and files."""
        return "/".join(f"{100 * share:.0f}" for share in self.shares)

    @property
    def experts(self) -> np.ndarray:
        """The chunk (modes, CHUNK, 2) that leads to each goal from the start, without noise."""
        angles = np.pi / 2 + 2 * np.pi * np.arange(len(self.shares)) / len(self.shares)
        return path(angles, np.ones_like(angles), np.full_like(angles, BOW))[:, 1 : CHUNK + 1]

    def demonstrate(self, seed: int) -> Batch:
        """Every chunk of every episode: state (N, 2), action (N, CHUNK, 2) and padding (N, CHUNK)."""
        rng = np.random.default_rng(seed)
        counts = np.round(np.array(self.shares) * self.episodes).astype(int)
        modes = np.repeat(np.arange(len(counts)), counts)
        angles = np.pi / 2 + 2 * np.pi * modes / len(counts) + rng.normal(0, NOISE, len(modes))
        distances, bows = rng.normal((1, BOW), NOISE, (len(modes), 2)).T
        paths = path(angles, distances, bows)  # (episodes, LENGTH + 1, 2)
        steps = np.arange(LENGTH)[:, None] + np.arange(1, CHUNK + 1)
        actions = paths[:, np.minimum(steps, LENGTH)]
        is_pad = np.broadcast_to(steps > LENGTH, actions.shape[:-1])
        return {
            "observation.state": torch.tensor(paths[:, :-1].reshape(-1, 2), dtype=torch.float32),
            "action": torch.tensor(actions.reshape(-1, CHUNK, 2), dtype=torch.float32),
            "action_is_pad": torch.tensor(is_pad.reshape(-1, CHUNK)),
        }


def path(angles: np.ndarray, distances: np.ndarray, bows: np.ndarray) -> np.ndarray:
    """Positions (n, LENGTH + 1, 2) from the origin to goals at these angles and distances."""
    way = np.linspace(0, 1, LENGTH + 1)
    along, across = distances[:, None] * way, bows[:, None] * np.sin(np.pi * way)
    cos, sin = np.cos(angles)[:, None], np.sin(angles)[:, None]
    return np.stack([cos * along - sin * across, sin * along + cos * across], axis=-1)


@dataclass(frozen=True)
class Judged:
    """What sampled chunks are.

    Attributes:
        counts: chunks that follow each goal's expert.
        chunks: of all, valid or not.
        distance: median RMS distance from the nearest expert.
    """

    counts: list[int]
    chunks: int
    distance: float

    @property
    def invalid(self) -> int:
        """Chunks that follow none."""
        return self.chunks - sum(self.counts)

    def covered(self, planted: Planted) -> int:
        """How many modes are."""
        least = [COVERED * share * self.chunks for share in planted.shares]
        return sum(count >= few for count, few in zip(self.counts, least, strict=True))


def judge(chunks: np.ndarray, planted: Planted) -> Judged:
    """Which expert each of the chunks (n, CHUNK, 2) from the start follows."""
    apart = chunks[:, None] - planted.experts  # (n, modes, CHUNK, 2)
    distances = np.sqrt((apart**2).sum(-1).mean(-1))
    nearest, least = distances.argmin(1), distances.min(1)
    counts = np.bincount(nearest[least < VALID], minlength=len(planted.shares))
    return Judged(counts.tolist(), len(chunks), float(np.median(least)))
