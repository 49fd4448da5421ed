"""Trains one cell, looks at it, and lets it act."""

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, get_type_hints

import draccus
import numpy as np
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.datasets.factory import resolve_delta_timestamps
from lerobot.policies.factory import make_policy, make_pre_post_processors
from lerobot.utils.import_utils import register_third_party_plugins
from torch import Tensor
from torch.utils.data import DataLoader, RandomSampler, Subset

from lerobot_act_chunking.data.batch import TOKENS, TOKENS_MASK
from lerobot_act_chunking.data.fast_chunks.dataset import FastChunkDataset
from lerobot_act_chunking.diagnostics.core.environments import environment_of
from lerobot_act_chunking.diagnostics.core.rollouts import roll_out
from lerobot_act_chunking.diagnostics.lm_ablation.cells import Cell
from lerobot_act_chunking.diagnostics.lm_ablation.corpus import Tokenizer
from lerobot_act_chunking.diagnostics.lm_ablation.records import Record
from lerobot_act_chunking.diagnostics.lm_ablation.settings import Settings
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.nn.language.encoder import TextEncoder
from lerobot_act_chunking.nn.language.weights import component_of
from lerobot_act_chunking.policies.language.tokens import InstructionTokens
from lerobot_act_chunking.policies.loading import LoadedPolicy

POLICY = "act_chunked"
VALIDATION_SAMPLES, AT_ONCE, CLIP = 256, 64, 10.0


@dataclass(frozen=True)
class Laboratory:
    """What every training shares.

    Attributes:
        settings: what is asked.
        meta: LeRobot's metadata of the dataset.
        tokenizer: of the instructions; None where nobody reads any.
        vocabulary: word pieces that encoders know; 0 likewise.
    """

    settings: Settings
    meta: Any
    tokenizer: Tokenizer | None
    vocabulary: int

    def config(self, cell: Cell, weights: Path | None) -> Any:
        """The configuration of a cell's policy, without its features.

        Raises:
            ConfigurationError: settings that cannot work.
        """
        register_third_party_plugins()
        made_for = {
            "encoder_vocabulary": self.vocabulary,
            "encoder_text_tokens": self.settings.text_tokens,
            "encoder_weights": None if weights is None else str(weights),
        }
        config_class: Any = PreTrainedConfig.get_choice_class(POLICY)
        given = _decoded(config_class, self.settings.policy)
        return config_class(**{"push_to_hub": False, "device": "cpu", **given, **cell.fields, **made_for})

    def policy(self, cell: Cell, weights: Path | None, seed: int) -> LoadedPolicy:
        """A fresh policy and its processors, which also read the task."""
        torch.manual_seed(seed)
        policy = make_policy(self.config(cell, weights), ds_meta=self.meta)
        before, after = make_pre_post_processors(policy.config, dataset_stats=self.meta.stats)
        before.steps = [each for each in before.steps if not isinstance(each, InstructionTokens)]
        return LoadedPolicy(policy, partial(self._processed, before), after)

    def train(self, cell: Cell, weights: Path | None, size: int, seed: int) -> Record:
        """One training, and how its policy acts under every condition."""
        started = time.process_time()
        loaded = self.policy(cell, weights, seed)
        before = _body(loaded.policy)
        curve = tuple(self._learn(loaded, size, seed))
        moved = _moved(before, _body(loaded.policy))
        successes = {}
        for name, environment in self.settings.conditions.items():
            env_config = environment_of(loaded.policy.config, environment)
            seeds = range(self.settings.seed, self.settings.seed + self.settings.budget.episodes)
            rollouts = roll_out(loaded, env_config, seeds, n_envs=50, log_chunks=False)
            successes[name] = tuple(each.success for each in rollouts)
        return Record(cell.name, size, seed, curve, successes, moved, time.process_time() - started)

    def _learn(self, loaded: LoadedPolicy, size: int, seed: int) -> Iterator[tuple[int, float]]:
        """Train, as LeRobot does; yields the validation loss before and after."""
        policy, budget = loaded.policy, self.settings.budget
        dataset = self._dataset(policy.config)
        optimizer = policy.config.get_optimizer_preset().build(policy.get_optim_params())
        preset = policy.config.get_scheduler_preset()
        scheduler = None if preset is None else preset.build(optimizer, budget.steps)
        looks = {round(each) for each in np.linspace(0, budget.steps, budget.looks + 1)[1:]}
        yield 0, self._validation_loss(loaded, dataset)
        batches = self._batches(dataset, size, seed)
        policy.train()
        for step, batch in enumerate(batches, start=1):
            loss, _ = policy.forward(loaded.preprocessor(batch))
            loss.backward()
            torch.nn.utils.clip_grad_norm_(policy.parameters(), CLIP)
            optimizer.step()
            optimizer.zero_grad()
            if scheduler is not None:
                scheduler.step()
            policy.update()
            if step in looks:
                yield step, self._validation_loss(loaded, dataset)
                policy.train()

    def _batches(self, dataset: FastChunkDataset, size: int, seed: int) -> DataLoader:
        """Those of a training: ``size`` demonstrations, which follow from the seed."""
        chosen = np.random.default_rng(seed).permutation(self.n_learnable)[:size]
        rows = np.flatnonzero(np.isin(self._episodes, chosen))
        budget, generator = self.settings.budget, torch.Generator().manual_seed(seed)
        drawn = RandomSampler(
            rows, replacement=True, num_samples=budget.steps * budget.batch_size, generator=generator
        )
        return DataLoader(Subset(dataset, rows.tolist()), budget.batch_size, sampler=drawn)

    @torch.no_grad()
    def _validation_loss(self, loaded: LoadedPolicy, dataset: FastChunkDataset) -> float:
        rows = np.flatnonzero(self._episodes >= self.n_learnable)
        rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), VALIDATION_SAMPLES)).round().astype(int)]
        loaded.policy.eval()
        total = 0.0
        for batch in DataLoader(Subset(dataset, rows.tolist()), AT_ONCE):
            losses, _ = loaded.policy.forward(loaded.preprocessor(batch), reduction="none")
            total += float(losses.sum())
        return total / len(rows)

    @property
    def n_learnable(self) -> int:
        """Demonstrations that are not held out."""
        return self.meta.total_episodes - self.settings.held_out

    def check(self) -> None:
        """Refuse sizes that the dataset has not.

        Raises:
            ConfigurationError: naming the largest one.
        """
        most = max(self.settings.sizes)
        if self.n_learnable < most:
            raise ConfigurationError(
                f"sizes={most}: the dataset has {self.meta.total_episodes} demonstrations, of which "
                f"{self.settings.held_out} are held out; record more, or give smaller --sizes"
            )

    @cached_property
    def _episodes(self) -> np.ndarray:
        """The episode of each frame."""
        lengths = np.asarray(self.meta.episodes["length"])
        return np.repeat(np.arange(len(lengths)), lengths)

    def _dataset(self, config: Any) -> FastChunkDataset:
        deltas = resolve_delta_timestamps(config, self.meta)
        return FastChunkDataset(self.meta.repo_id, root=self.meta.root, delta_timestamps=deltas)

    def _processed(self, before: Any, batch: dict[str, Any]) -> dict[str, Any]:
        """The batch through the policy's processor, with the word pieces of its tasks."""
        if self.tokenizer is not None:
            text = self.tokenizer(list(batch["task"]))
            batch = {**batch, TOKENS: text.tokens, TOKENS_MASK: ~text.is_pad}
        return before(batch)


def _decoded(config_class: type, given: Mapping[str, Any]) -> dict[str, Any]:
    """Values of the fields' types, from what YAML makes of a command line.

    Raises:
        ConfigurationError: no such field, or a value that it does not take.
    """
    hints, found = get_type_hints(config_class), {}
    for name, value in given.items():
        try:
            found[name] = draccus.decode(hints[name], value)
        except Exception as error:  # draccus raises what it comes upon
            raise ConfigurationError(f"{POLICY} does not take --policy.{name}={value}: {error!r}") from error
    return found


def _body(policy: Any) -> dict[str, Tensor]:
    """The weights of the encoder that learn."""
    encoder: TextEncoder = policy.model.encoder
    return {name: each.detach().clone() for name, each in encoder.named_parameters() if each.requires_grad}


def _moved(before: dict[str, Tensor], after: dict[str, Tensor]) -> dict[str, float]:
    """The length of the change of each kind of weights, as a share of their length before."""
    kinds = {component_of(name) for name in before}
    squares = {
        kind: [
            sum(float(value.square().sum()) for name, value in values.items() if component_of(name) == kind)
            for values in ({name: after[name] - before[name] for name in before}, before)
        ]
        for kind in sorted(kinds)
    }
    return {kind: (change / max(was, 1e-12)) ** 0.5 for kind, (change, was) in squares.items()}
