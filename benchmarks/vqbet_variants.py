"""What benchmarks/vqbet_success.py trains, and how it lets it act."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from policy_study import Run
from policy_training import Variant

RECIPE: dict[str, Any] = yaml.safe_load((Path(__file__).parents[1] / "configs/vqbet.yaml").read_text())
POLICY = RECIPE["policy"]
SEEDS = (0, 1, 2)


def ours(before: tuple[str, ...] = (), **changes: Any) -> Variant:
    """The recipe but for these settings."""
    return Variant({**POLICY, **changes}, RECIPE["steps"], RECIPE["batch_size"], before)


TRAIN_TOKENIZER = (
    *("act-chunking", "train-tokenizer", "{dataset}", "--out", "{folder}/tokenizer.safetensors"),
    *("--steps", "500", "--batch-size", str(RECIPE["batch_size"])),
    *("--chunk-size", str(POLICY["chunk_size"]), "--chunk-stride", str(POLICY["chunk_stride"])),
)

# Up to 280 codes, one after the other, would take hours to train on a core: all at once. As many bins for
# `uniform` as give it about as many logits as `dct` has.
TOKENIZERS = {
    "fsq": ours(tokenizer="fsq"),
    "dct": ours(tokenizer="dct", sequentially_select=False),
    "uniform": ours(tokenizer="uniform", n_bins=17, sequentially_select=False),
    "apart": ours(TRAIN_TOKENIZER, tokenizer_path="{folder}/tokenizer.safetensors"),
    "joint": ours(tokenizer_training="joint", use_ema=False),
    "residual_vq_4_levels": ours(vqvae_num_layers=4),
}

PARTS = {
    "no_offset": ours(offset_loss_weight=0),
    "parallel": ours(sequentially_select=False),
    "two_observations": ours(n_obs_steps=2),
    "sampled_target": ours(offset_target="sampled"),
    "every_step": ours(chunk_size=50, chunk_stride=1),
    "table": ours(offset_mode="table"),
}

VARIANTS = {"recipe": ours(), **TOKENIZERS, **PARTS}


def recipe(task: str) -> Iterator[Run]:
    """The headline: three training seeds."""
    for seed in SEEDS:
        yield Run(task, "recipe", seed)


def tokenizers(task: str) -> Iterator[Run]:
    """What else could make codes of actions, and when."""
    for name in TOKENIZERS:
        yield Run(task, name)


def parts(task: str) -> Iterator[Run]:
    """One setting changed at a time."""
    for name in PARTS:
        yield Run(task, name)


def sampling(task: str) -> Iterator[Run]:
    """How codes are chosen."""
    for temperature in (0.0, 0.1):
        yield Run(task, "recipe", sampling={"bet_softmax_temperature": temperature})
    yield Run(task, "recipe", sampling={"code_hold": "episode"})
    yield Run(task, "dct", sampling={"bet_softmax_temperature": 0.0})


STUDIES = {"recipe": recipe, "tokenizers": tokenizers, "parts": parts, "sampling": sampling}
