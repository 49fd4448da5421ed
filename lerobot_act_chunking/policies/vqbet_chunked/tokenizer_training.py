"""Training a tokenizer apart from any policy."""

import io
import logging
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from time import monotonic
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from lerobot.configs import NormalizationMode
from lerobot.utils.constants import OBS_PREFIX

from lerobot_act_chunking.data.action_kind import dataset_asks_for_changes
from lerobot_act_chunking.data.actions import Demonstrations, read_demonstrations
from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.durable_files import write_atomically
from lerobot_act_chunking.errors import ConfigurationError, unknown_choice
from lerobot_act_chunking.policies.dataset_defaults import fitting_length, spaced_stride
from lerobot_act_chunking.policies.vqbet_chunked.action_chunks import ActionChunks
from lerobot_act_chunking.policies.vqbet_chunked.configuration_vqbet_chunked import VqbetChunkedConfig
from lerobot_act_chunking.policies.vqbet_chunked.presets import preset_values
from lerobot_act_chunking.policies.vqbet_chunked.tokenizer_file import (
    TokenizerInfo,
    TokenizerTraining,
    load_tokenizer,
    read_info,
    save_tokenizer,
)
from lerobot_act_chunking.tokenizers.learned import perplexity
from lerobot_act_chunking.tokenizers.make import TOKENIZERS, check_tokenizer, make_tokenizer
from lerobot_act_chunking.tokenizers.quantizers import seeded
from lerobot_act_chunking.tokenizers.spec import TokenizerSpec
from lerobot_act_chunking.tokenizers.tokenizer import ActionTokenizer

logger = logging.getLogger(__name__)

SAVE_EVERY_S = 5.0
"""What Ctrl-C, kill -9 or a power cut can cost at most."""
AT_ONCE = 4096
"""Chunks encoded at a time to measure the finished tokenizer."""

Progress = Callable[[int, dict[str, float]], None]
"""Told the steps that are done, and the newest numbers."""


@dataclass(frozen=True)
class Trained:
    """A finished tokenizer, measured on all that it has learned from.

    Attributes:
        info: what its file says.
        error: mean absolute error of encoding and decoding by action dimension, in raw units.
        ranges: between the smallest and the largest raw value of each dimension.
        used_codes: of each level, how many codes occur.
        perplexity: of each level.
        combinations: different chunks that the codes of all levels together stand for, of those that occur.
        steps_before: steps that an earlier, interrupted call had done; all of them if the file was there.
    """

    info: TokenizerInfo
    error: dict[str, float]
    ranges: list[float]
    used_codes: list[int]
    perplexity: list[float]
    combinations: int
    steps_before: int


def plan_training(
    dataset: Path, preset: str, fields: Mapping[str, Any], training: TokenizerTraining
) -> tuple[TokenizerInfo, ActionChunks]:
    """What to train, and on what, for a policy with these settings.

    Args:
        dataset: folder of a LeRobotDataset.
        preset: of `VqbetChunkedConfig`, for the fields that are not given; ``base`` spaces predictions as
            its policy's training does.
        fields: of `VqbetChunkedConfig`, and ``normalization``, that of actions.
        training: how to train.

    Raises:
        ConfigurationError: a setting cannot work.
        DatasetError: the dataset cannot be read, or cannot be normalised in this way.
    """
    training.check()
    values = {**preset_values(preset, tokenizer=fields.get("tokenizer"), pretrained=False), **fields}
    mode, modes = values.get("normalization"), [each.value for each in NormalizationMode]
    mode = values["normalization_mapping"]["ACTION"].value if mode is None else mode.upper()
    if mode not in modes:
        raise unknown_choice("normalization", mode, modes)
    demonstrations = read_demonstrations(dataset)
    if preset in VqbetChunkedConfig.spaced_presets and not {"chunk_size", "chunk_stride"} & fields.keys():
        values |= _fitting_chunk(demonstrations, values["chunk_size"])
    sizes = {"chunk_size": values["chunk_size"], "action_dim": len(demonstrations.names)}
    spec = TokenizerSpec.from_fields(SimpleNamespace(**values), **sizes)
    check_tokenizer(spec)
    if not TOKENIZERS[spec.tokenizer].is_learned:
        raise ConfigurationError(
            f"tokenizer={spec.tokenizer} has nothing to learn: use it without a file, as "
            f"--policy.tokenizer={spec.tokenizer}"
        )
    timing = ChunkTiming(1, spec.chunk_size, values["chunk_stride"])
    chunks = ActionChunks(demonstrations, timing, NormalizationMode(mode), values["norm_std_floor"])
    if timing.control_steps > chunks.longest_episode:
        logger.warning(
            "chunk_size=%d reaches beyond the dataset's longest episode (%d steps): what lies behind its end "
            "is padding and is not learned; without padding: --chunk-size %d",
            timing.chunk_size,
            chunks.longest_episode,
            (chunks.longest_episode - 1) // timing.chunk_stride + 1,
        )
    info = TokenizerInfo(
        spec=spec,
        chunk_stride=timing.chunk_stride,
        normalization=mode,
        norm_std_floor=values["norm_std_floor"],
        statistics=chunks.statistics,
        dataset=str(dataset),
        n_frames=len(chunks),
        training=training,
    )
    return info, chunks


def _fitting_chunk(demonstrations: Demonstrations, usual: int) -> dict[str, int]:
    """Length and spacing of the chunks that a policy would have that is trained on the same data."""
    folder, fps, features = demonstrations.folder, demonstrations.fps, demonstrations.features
    states = [key for key, each in features.items() if key.startswith(OBS_PREFIX) and len(each["shape"]) == 1]
    stride = 1 if dataset_asks_for_changes(folder, features, states) else spaced_stride(fps)
    _, lengths = np.unique(demonstrations.episode, return_counts=True)
    return {"chunk_size": fitting_length(usual, stride, fps, lengths.tolist()), "chunk_stride": stride}


def train_tokenizer(
    output: Path, info: TokenizerInfo, chunks: ActionChunks, progress: Progress = lambda done, numbers: None
) -> Trained:
    """Train a tokenizer and write its file; interrupted and called again, go on where it was.

    Every step's batch and draws follow from the seed and the step's number: a resumed training ends, bit for
    bit, where an undisturbed one does.

    Args:
        output: the file. While training, its state is in ``<name>.training`` beside it.
        info: what to train, and how.
        chunks: what to learn from.
        progress: called after every step.

    Raises:
        ConfigurationError: ``output``, or what an interrupted training left, is of other settings.
    """
    if output.exists():
        _refuse_other(read_info(output), info, output)
        tokenizer = make_tokenizer(info.spec)
        tokenizer.load_state_dict(load_tokenizer(output).state)
        return _measure(tokenizer, info, chunks, info.training.steps)
    training = _Training(info, output.with_name(f"{output.name}.training"))
    before = training.done
    training.run(chunks, progress)
    save_tokenizer(output, training.tokenizer, info)
    training.path.unlink(missing_ok=True)
    return _measure(training.tokenizer, info, chunks, before)


class _Training:
    """A tokenizer on its way, with all that an interruption must not lose."""

    def __init__(self, info: TokenizerInfo, path: Path):
        self.info = info
        self.path = path
        self.done = 0
        with seeded(info.training.seed, torch.device("cpu")):
            self.tokenizer = make_tokenizer(info.spec)
        self.optimizer = torch.optim.AdamW(
            self.tokenizer.parameters(), lr=info.training.lr, weight_decay=info.training.weight_decay
        )
        if path.exists():
            self._resume()

    def run(self, chunks: ActionChunks, progress: Progress) -> None:
        """All steps that are left."""
        saved = monotonic()
        while self.done < self.info.training.steps:
            numbers = self._step(chunks)
            self.done += 1
            progress(self.done, numbers)
            if monotonic() - saved > SAVE_EVERY_S:
                self._save()
                saved = monotonic()

    def _step(self, chunks: ActionChunks) -> dict[str, float]:
        training = self.info.training
        batch_seed, seed = np.random.SeedSequence((training.seed, self.done)).generate_state(2, np.uint64)
        rows = np.random.default_rng(batch_seed).integers(len(chunks), size=training.batch_size)
        learned = self.tokenizer.learn(*chunks.take(rows), int(seed))
        loss = learned.loss.mean()
        if not torch.isfinite(loss):
            raise ConfigurationError(
                f"the loss is not finite in step {self.done + 1}: lower --lr (now {training.lr:g})"
            )
        self.optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()
        return {"loss": loss.item(), **learned.metrics}

    def _save(self) -> None:
        content = {
            "info": self.info.to_json(),
            "done": self.done,
            "tokenizer": self.tokenizer.state_dict(),
            "optimizer": self.optimizer.state_dict(),
        }
        buffer = io.BytesIO()
        torch.save(content, buffer)
        write_atomically(self.path, buffer.getvalue())

    def _resume(self) -> None:
        content = torch.load(self.path, weights_only=True)
        _refuse_other(TokenizerInfo.from_json(content["info"]), self.info, self.path)
        self.done = content["done"]
        self.tokenizer.load_state_dict(content["tokenizer"])
        self.optimizer.load_state_dict(content["optimizer"])


def _refuse_other(found: TokenizerInfo, wanted: TokenizerInfo, path: Path) -> None:
    """Refuse to go on with, or to overwrite, what was made with other settings or data."""
    theirs, ours = _flat(asdict(found)), _flat(asdict(wanted))
    differing = [f"{name} {theirs[name]} (now {ours[name]})" for name in ours if theirs[name] != ours[name]]
    if differing:
        raise ConfigurationError(
            f"{path} was made with {', '.join(differing)}: delete it, use another --out, or ask for "
            "the same again"
        )


def _flat(values: dict[str, Any]) -> dict[str, Any]:
    """Settings by their own names; the same data may have moved to another folder."""
    nested = values.pop("spec") | values.pop("training")
    del values["dataset"]
    return values | nested


@torch.no_grad()
def _measure(tokenizer: ActionTokenizer, info: TokenizerInfo, chunks: ActionChunks, before: int) -> Trained:
    error, count, codes = torch.zeros(info.spec.action_dim), 0, []
    for rows in np.array_split(np.arange(len(chunks)), -(-len(chunks) // AT_ONCE)):
        actions, is_pad = chunks.take(rows)
        codes.append(tokenizer.encode(actions))
        difference = (chunks.raw(tokenizer.decode(codes[-1])) - chunks.raw(actions)).abs()
        error += difference[~is_pad].sum(0)
        count += int((~is_pad).sum())
    found = torch.cat(codes)
    return Trained(
        info=info,
        error=dict(zip(chunks.names, (error / count).tolist(), strict=True)),
        ranges=chunks.ranges,
        used_codes=[len(level.unique()) for level in found.unbind(1)],
        perplexity=perplexity(found, tokenizer.vocabulary).tolist(),
        combinations=len(found.unique(dim=0)),
        steps_before=before,
    )
