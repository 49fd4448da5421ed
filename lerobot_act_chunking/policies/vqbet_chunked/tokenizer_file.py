"""A trained tokenizer as a file: weights and codes, and what they were made from."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from lerobot.configs import NormalizationMode
from lerobot.utils.constants import ACTION
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save
from torch import Tensor

from act_chunking_runtime.number_checks import check_at_least
from lerobot_act_chunking.durable_files import write_atomically
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.json_files import parse_json
from lerobot_act_chunking.policies.statistics import NEEDED, floored_statistics
from lerobot_act_chunking.tokenizers.make import building_settings
from lerobot_act_chunking.tokenizers.spec import TokenizerSpec
from lerobot_act_chunking.tokenizers.tokenizer import ActionTokenizer

if TYPE_CHECKING:
    from lerobot_act_chunking.policies.vqbet_chunked.configuration_vqbet_chunked import VqbetChunkedConfig

HEADER = "act_chunking_tokenizer"
_TRAINING = "lessons"  # the name of `TokenizerInfo.training` in files
TOLERANCE = 1e-5
"""How far statistics may differ, relative to their largest value: what float32 rounds."""


@dataclass(frozen=True)
class TokenizerTraining:
    """How a tokenizer was trained.

    Attributes:
        steps: optimiser steps.
        batch_size: chunks per step.
        lr: learning rate.
        weight_decay: of AdamW.
        seed: of the first weights, the batches and what is drawn in them.
    """

    steps: int = 2000
    batch_size: int = 256
    lr: float = 1e-3
    weight_decay: float = 1e-4
    seed: int = 0

    def check(self) -> None:
        """Refuse values that cannot work.

        Raises:
            ConfigurationError: naming the value.
        """
        check_at_least(1, steps=self.steps, batch_size=self.batch_size)
        check_at_least(0, lr=self.lr, weight_decay=self.weight_decay, seed=self.seed)


@dataclass(frozen=True)
class TokenizerInfo:
    """What a tokenizer file says about itself.

    Attributes:
        spec: what the tokenizer is built from.
        chunk_stride: control steps between the actions of its chunks.
        normalization: of its actions, as in ``normalization_mapping``: MEAN_STD, MIN_MAX, QUANTILES, ...
        norm_std_floor: least spread in the statistics.
        statistics: the two that the normalisation uses, floored.
        dataset: folder of the demonstrations.
        n_frames: how many control steps they have.
        training: how it was trained.
    """

    spec: TokenizerSpec
    chunk_stride: int
    normalization: str
    norm_std_floor: float
    statistics: dict[str, list[float]]
    dataset: str
    n_frames: int
    training: TokenizerTraining

    @property
    def policy_fields(self) -> dict[str, Any]:
        """The fields of a policy's configuration that follow from the tokenizer, with their values."""
        sizes = {"chunk_stride": self.chunk_stride, "norm_std_floor": self.norm_std_floor}
        return building_settings(self.spec) | sizes

    def to_json(self) -> str:
        """As text."""
        values = asdict(self)
        values[_TRAINING] = values.pop("training")
        return json.dumps(values)

    @classmethod
    def from_json(cls, text: str) -> "TokenizerInfo":
        """From its text."""
        values = parse_json(text)
        parts = {
            "spec": TokenizerSpec.from_values(values["spec"]),
            "training": TokenizerTraining(**values.pop(_TRAINING)),
        }
        return cls(**values | parts)


class LoadedTokenizer(NamedTuple):
    """The content of a tokenizer file."""

    spec: TokenizerSpec
    info: TokenizerInfo
    state: dict[str, Tensor]


def save_tokenizer(path: Path, tokenizer: ActionTokenizer, info: TokenizerInfo) -> None:
    """Write a tokenizer file in one step; a crash leaves what was there before."""
    state = {name: value.cpu().contiguous() for name, value in tokenizer.state_dict().items()}
    write_atomically(path, save(state, {HEADER: info.to_json()}))


def read_info(path: Path) -> TokenizerInfo:
    """What a tokenizer file says about itself, without reading its weights.

    Raises:
        ConfigurationError: there is no such file, or it is none of a tokenizer.
    """
    if not path.is_file():
        raise ConfigurationError(
            f"there is no tokenizer at {path}: make one with "
            f"act-chunking train-tokenizer DATASET --out {path}"
        )
    try:
        with safe_open(path, "pt") as file:
            header = (file.metadata() or {})[HEADER]
        return TokenizerInfo.from_json(header)
    except (SafetensorError, ValueError, KeyError, TypeError) as error:
        raise ConfigurationError(
            f"{path} is not a file of act-chunking train-tokenizer (or of another version): {error}"
        ) from error


def load_tokenizer(path: Path) -> LoadedTokenizer:
    """Read a tokenizer file.

    Raises:
        ConfigurationError: there is no such file, or it is none of a tokenizer.
    """
    info = read_info(path)
    return LoadedTokenizer(info.spec, info, load_file(path))


def load_for(
    config: "VqbetChunkedConfig", tokenizer: ActionTokenizer, dataset_stats: Mapping[str, Any] | None
) -> None:
    """Give a policy's fresh tokenizer the weights of ``config.tokenizer_path``.

    Raises:
        ConfigurationError: the file is of a tokenizer that does not fit the policy or its normalisation.
        DatasetError: the dataset lacks the statistics to normalise actions by.
    """
    _spec, info, state = load_tokenizer(Path(str(config.tokenizer_path)))
    check_fits(info, config.tokenizer_spec, config.chunk_stride)
    stats = None
    if dataset_stats is not None:
        stats = floored_statistics(config, dataset_stats, config.norm_std_floor)[ACTION]
    check_normalization(info, config.normalization_mapping["ACTION"], stats)
    tokenizer.load_state_dict(state)


def check_fits(info: TokenizerInfo, spec: TokenizerSpec, chunk_stride: int) -> None:
    """Refuse a tokenizer file that is of other chunks, or built otherwise, than a policy's tokenizer.

    Raises:
        ConfigurationError: naming the field, both values and the way out.
    """
    theirs = {
        **building_settings(info.spec),
        "chunk_stride": info.chunk_stride,
        "action_dim": info.spec.action_dim,
    }
    ours = {"chunk_stride": chunk_stride, "action_dim": spec.action_dim}
    for name, value in theirs.items():
        own = ours.get(name, getattr(spec, name, None))
        if own != value:
            out = (
                "train a tokenizer for these actions"
                if name == "action_dim"
                else f"leave out --policy.{name}, or train a tokenizer with {name}={own}"
            )
            raise ConfigurationError(f"the tokenizer file has {name}={value}, the policy {name}={own}: {out}")


def check_normalization(
    info: TokenizerInfo, mode: NormalizationMode | str, stats: Mapping[str, Any] | None
) -> None:
    """Refuse to use a tokenizer on actions that are normalised otherwise than those it has learned.

    Args:
        info: the tokenizer's.
        mode: how the policy normalises actions.
        stats: the floored statistics of its actions, by name; None if they are not known.

    Raises:
        ConfigurationError: naming the difference and the way out.
    """
    mode = NormalizationMode(mode)
    if mode.value != info.normalization:
        raise ConfigurationError(
            f"the tokenizer has learned actions normalised by {info.normalization}, the policy normalises "
            f"them by {mode.value}: set the ACTION entry of normalization_mapping to {info.normalization}, "
            f"or train a tokenizer with --normalization {mode.value}"
        )
    if stats is None:
        return
    for name in NEEDED.get(mode, ()):
        theirs = torch.tensor(info.statistics[name])
        ours = torch.as_tensor(stats[name], dtype=torch.float32).cpu()
        worst = int((theirs - ours).abs().argmax())
        if (theirs - ours).abs().max() > TOLERANCE * theirs.abs().max():
            raise ConfigurationError(
                f"the tokenizer was trained on {info.dataset} (norm_std_floor={info.norm_std_floor}), where "
                f"{name!r} of action {worst} is {theirs[worst]:.6g}; here it is {ours[worst]:.6g}: train a "
                "tokenizer on this dataset, with this norm_std_floor"
            )
