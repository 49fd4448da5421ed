"""All tokenizers, like for like: fitted to most episodes of a dataset, tried on the others."""

from collections.abc import Callable, Iterable, Sequence
from time import process_time

import numpy as np
import torch
from lerobot.configs import NormalizationMode
from torch import Tensor

from act_chunking_runtime.number_checks import check_at_least
from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.diagnostics.codebook.chunks import DemonstratedChunks, cut_chunks
from lerobot_act_chunking.diagnostics.codebook.coding import ChunkCoder
from lerobot_act_chunking.diagnostics.codebook.comparison.candidates import Candidate, candidates_for
from lerobot_act_chunking.diagnostics.codebook.comparison.report import ComparisonReport, Fitted
from lerobot_act_chunking.diagnostics.codebook.losses import measure_losses
from lerobot_act_chunking.diagnostics.codebook.scale import ActionScale
from lerobot_act_chunking.diagnostics.codebook.settings import Thresholds
from lerobot_act_chunking.diagnostics.codebook.usage import measure_usage
from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes
from lerobot_act_chunking.diagnostics.core.measures import measure_of
from lerobot_act_chunking.diagnostics.core.report import Judgement
from lerobot_act_chunking.errors import DatasetError
from lerobot_act_chunking.policies.statistics import NEEDED
from lerobot_act_chunking.policies.vqbet_chunked.presets import preset_values
from lerobot_act_chunking.tokenizers.make import TOKENIZERS, make_tokenizer
from lerobot_act_chunking.tokenizers.quantizers import seeded
from lerobot_act_chunking.tokenizers.tokenizer import ActionTokenizer

HELD_OUT = 0.2
"""Share of the episodes, from the last one backwards, on which errors are measured."""
LEAST_SPREAD = preset_values("base", tokenizer=None, pretrained=False)["norm_std_floor"]
BATCH, LEARNING_RATE = 256, 1e-3

Watch = Callable[[Sequence[Candidate]], Iterable[Candidate]]


def compare(
    demonstrations: ActionEpisodes,
    timing: ChunkTiming,
    thresholds: Thresholds,
    *,
    steps: int,
    seed: int = 0,
    watch: Watch = iter,
) -> ComparisonReport:
    """Fit every candidate and measure what it loses on episodes held out.

    Args:
        demonstrations: the dataset.
        timing: of the chunks.
        thresholds: the first of ``lost_variance`` is what may be lost.
        steps: of fitting, for those that learn.
        seed: of their weights and batches.
        watch: the candidates go through it, to show how far it is.

    Raises:
        ConfigurationError: less than one step.
        DatasetError: a single episode, or none as long as half a chunk.
    """
    check_at_least(1, steps=steps)
    seen, held_out = _split(demonstrations)
    trial = _Trial(seen, held_out, timing, steps, seed)
    fitted = [trial.run(candidate) for candidate in watch(candidates_for(timing.chunk_size))]
    recommended, judgement = _recommend(fitted, thresholds.lost_variance[0])
    return ComparisonReport(
        demonstrations=demonstrations,
        timing=timing,
        held_out=list(held_out.episodes),
        steps=steps,
        fitted=fitted,
        recommended=recommended,
        thresholds=thresholds,
        judgement=judgement,
    )


class _Trial:
    """The same data and training for every candidate."""

    def __init__(
        self, seen: ActionEpisodes, held_out: ActionEpisodes, timing: ChunkTiming, steps: int, seed: int
    ):
        self.timing, self.steps, self.seed = timing, steps, seed
        self.seen, self.held_out = seen, held_out
        self.chunks, self.unseen = cut_chunks(seen, timing), cut_chunks(held_out, timing)
        self.measure = measure_of({"names": list(seen.names), "shape": (len(seen.names),)})

    def run(self, candidate: Candidate) -> Fitted:
        start = process_time()
        scale = _scale_for(candidate.kind, self.seen)
        tokenizer = self._fit(candidate, scale)
        seconds = process_time() - start
        coder = ChunkCoder(tokenizer, scale, self.timing)
        usage = measure_usage(coder.code(self.chunks).codes, tokenizer.vocabulary)
        return Fitted(
            candidate=candidate,
            tokens=tokenizer.n_codes,
            vocabulary=tokenizer.vocabulary,
            bits=usage.bits,
            entropy_bits=usage.entropy_bits,
            losses=measure_losses(coder.code(self.unseen), self.held_out, self.measure),
            seconds=seconds,
        )

    def _fit(self, candidate: Candidate, scale: ActionScale) -> ActionTokenizer:
        with seeded(self.seed, torch.device("cpu")):
            tokenizer = make_tokenizer(candidate.spec(self.timing.chunk_size, self.chunks.actions.shape[-1]))
        if tokenizer.is_learned:
            fit(tokenizer, scale.normalised(self.chunks.actions), self.chunks, self.steps, self.seed)
        return tokenizer


def fit(
    tokenizer: ActionTokenizer, actions: Tensor, chunks: DemonstratedChunks, steps: int, seed: int
) -> None:
    """Train a tokenizer briefly on normalised actions (N, C, A) of chunks, at a rate that falls to zero."""
    optimizer = torch.optim.AdamW(tokenizer.parameters(), LEARNING_RATE, weight_decay=1e-4, fused=True)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    generator = torch.Generator().manual_seed(seed)
    is_pad = torch.from_numpy(chunks.is_pad)
    tokenizer.train()
    for step in range(steps):
        rows = torch.randint(len(actions), (BATCH,), generator=generator)
        loss = tokenizer.learn(actions[rows], is_pad[rows], seed + step).loss.mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()


def _split(demonstrations: ActionEpisodes) -> tuple[ActionEpisodes, ActionEpisodes]:
    episodes = list(demonstrations.episodes)
    if len(episodes) < 2:
        raise DatasetError(
            f"{demonstrations.folder} has {len(episodes)} episode: it takes 2, because some are held out"
        )
    n_held_out = max(1, round(HELD_OUT * len(episodes)))
    return demonstrations.only(episodes[:-n_held_out]), demonstrations.only(episodes[-n_held_out:])


def _scale_for(tokenizer: str, demonstrations: ActionEpisodes) -> ActionScale:
    """As the policy would normalise actions for this tokenizer, had it these episodes."""
    mapping = preset_values("base", tokenizer=tokenizer, pretrained=False)["normalization_mapping"]
    mode: NormalizationMode = mapping["ACTION"]
    actions = np.concatenate(list(demonstrations.episodes.values()))
    low, high = actions.min(0), actions.max(0)
    centre, half = (low + high) / 2, np.maximum((high - low) / 2, LEAST_SPREAD)
    statistics = {
        "mean": actions.mean(0),
        "std": np.maximum(actions.std(0), LEAST_SPREAD),
        "min": centre - half,
        "max": centre + half,
    }
    needed = {name: statistics[name].astype(np.float32) for name in NEEDED[mode]}
    return ActionScale.of_statistics(mode, needed, len(low))


def _recommend(fitted: list[Fitted], allowed: float) -> tuple[Fitted, Judgement]:
    """The fewest bits among those that lose little; if none does, the one that loses least."""
    enough = [each for each in fitted if each.losses.lost_variance <= allowed]
    if not enough:
        best = min(fitted, key=lambda each: each.losses.lost_variance)
        return best, Judgement(
            "fail",
            [
                f"none loses less than {allowed:.0%} of what varies; the best, {best.candidate.name}, loses "
                f"{best.losses.lost_variance:.0%}: choose shorter chunks or more --steps"
            ],
        )
    best = min(enough, key=lambda each: (each.bits, each.losses.lost_variance))
    reason = (
        f"{best.candidate.name} says a chunk in the fewest bits, {best.bits:.4g}, of those that lose at "
        f"most {allowed:.0%} of what varies on episodes they have not seen"
    )
    learned = [each for each in fitted if TOKENIZERS[each.candidate.kind].is_learned]
    if best in learned or not learned:
        return best, Judgement("pass", [reason])
    return best, Judgement("warn", [reason, _many_codes(best, learned)])


def _many_codes(best: Fitted, learned: list[Fitted]) -> str:
    """Why to look further before training a policy on a tokenizer with a code for every coefficient."""
    nearest = min(learned, key=lambda each: each.losses.lost_variance)
    return (
        f"a policy has to get all {best.tokens} of its codes right; of those with few codes the best, "
        f"{nearest.candidate.name}, loses {nearest.losses.lost_variance:.0%}: try more --steps or shorter "
        "chunks first"
    )
