"""Tokenizers whose codes are known, and demonstrations to go with them."""

import numpy as np
import torch
from lerobot.configs import NormalizationMode

from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.diagnostics.codebook.coding import ChunkCoder
from lerobot_act_chunking.diagnostics.codebook.scale import ActionScale
from lerobot_act_chunking.diagnostics.codebook.subject import Subject
from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes
from lerobot_act_chunking.diagnostics.core.training import Training
from lerobot_act_chunking.tokenizers.tokenizer import ActionTokenizer

A, C, STRIDE = 2, 4, 3
FPS = 20.0
MEAN, STD = np.array([5.0, -1.0]), np.array([2.0, 0.1])
TIMING = ChunkTiming(1, C, STRIDE)


class Levels(ActionTokenizer):
    """The first code is the first action's first dimension in steps of 1, the second what is left, of 1/8.

    Both in normalised units from -4 on; the second dimension is not told.
    """

    n_codes = 2
    vocabulary = 8
    coarse_to_fine = True
    is_learned = True

    def encode(self, actions):
        told = (actions[:, 0, 0] + 4).clamp(0, 7.99)
        return torch.stack([told.floor(), (told % 1 * 8).floor()], dim=1).long()

    def decode(self, codes):
        told = codes[:, 0] + (codes[:, 1] + 0.5) / 8 - 4
        return torch.stack([told, torch.zeros_like(told)], dim=-1)[:, None].repeat(1, C, 1)


class Flat(Levels):
    """The same without an order between codes."""

    coarse_to_fine = False


def scale():
    return ActionScale.of_statistics(
        NormalizationMode.MEAN_STD, {"mean": torch.tensor(MEAN), "std": torch.tensor(STD)}, A
    )


def coder(tokenizer=None, timing=TIMING):
    return ChunkCoder(tokenizer or Levels(), scale(), timing)


def subject(coded_by=None, *, folder="data", unfinished=None, **settings):
    usual = {"tokenizer": "residual_vq", "kmeans_iters": 20, "dead_code_threshold": 0.1}
    return Subject(
        source="tokenizer.safetensors",
        kind="tokenizer file",
        coder=coder(coded_by),
        settings=usual | settings,
        action_dim=A,
        trained_on=Training(folder),
        unfinished=unfinished,
    )


def episodes(lengths=(40, 25), *, folder="data", seed=0, shift=0.0, spread=1.0, still=False):
    """Actions that stay where they are for an episode's length, each dimension drawn anew at every step."""
    rng = np.random.default_rng(seed)
    by_episode = {}
    for episode, length in enumerate(lengths):
        values = spread * rng.normal(size=(length, A)) + np.array([shift, 0])
        if still:
            values[:, 1] = 0
        by_episode[episode] = (MEAN + STD * values).astype(np.float32)
    return ActionEpisodes(folder, FPS, ("reach", "gripper"), by_episode)
