"""Everything the diagnosis found, as one object: the command prints it, JSON holds it, plots draw it."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_act_chunking.diagnostics.codebook.chunks import CodedChunks, cut_chunks
from lerobot_act_chunking.diagnostics.codebook.drift import Drift, measure_drift
from lerobot_act_chunking.diagnostics.codebook.losses import Losses, measure_losses
from lerobot_act_chunking.diagnostics.codebook.meaning import CodeUse, uses_of_first_code
from lerobot_act_chunking.diagnostics.codebook.subject import Subject
from lerobot_act_chunking.diagnostics.codebook.usage import Usage, measure_usage
from lerobot_act_chunking.diagnostics.codebook.verdict import Judgement, Thresholds, judge
from lerobot_act_chunking.diagnostics.core import outcome
from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes
from lerobot_act_chunking.diagnostics.core.measures import Measure, measure_of
from lerobot_act_chunking.diagnostics.core.noise_floor import listed
from lerobot_act_chunking.diagnostics.core.training import untrained

BINS = (
    "Its codes are bins of single values and none refines another: what a single code does is not drawn, and "
    "empty bins are no fault."
)
NOT_TRAINING_DATA = (
    "The data it was trained on are not here ({folder}): usage and errors are those of {given}, and drift "
    "cannot be measured."
)
SAME_DATA = "--dataset is the data it was trained on: there is no drift to measure."


@dataclass(frozen=True)
class CodebookReport:
    """The answer to: what does this codebook do, and does it still fit?

    Attributes:
        subject: the tokenizer and where it comes from.
        demonstrations: the data that usage and errors are those of: what it was trained on, if that is here.
        coded: these, coded.
        uses: what each value of the first code does; empty where codes do not refine one another.
        drift: of other data, if any were given.
        other: these data, coded.
    """

    subject: Subject
    demonstrations: ActionEpisodes
    measure: Measure
    coded: CodedChunks
    usage: Usage
    losses: Losses
    uses: list[CodeUse]
    drift: Drift | None
    other: CodedChunks | None
    thresholds: Thresholds
    judgement: Judgement
    notes: list[str]

    @property
    def exit_code(self) -> int:
        """Of the command: 0 pass or warn, 1 fail, 2 inconclusive."""
        return outcome.EXIT_CODES[self.judgement.verdict]

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dictionaries; None for what was not measured."""
        subject = self.subject
        return {
            "tool": "codebook",
            "version": version("lerobot_policy_act_chunking"),
            "checkpoint": subject.source,
            "kind": subject.kind,
            "settings": dict(subject.settings),
            "dataset": self.demonstrations.folder,
            "episodes": list(self.demonstrations.episodes),
            "fps": self.demonstrations.fps,
            "n_chunks": len(self.coded.chunks),
            "chunk_size": subject.coder.timing.chunk_size,
            "chunk_stride": subject.coder.timing.chunk_stride,
            "verdict": self.judgement.verdict,
            "reasons": self.judgement.reasons,
            "thresholds": asdict(self.thresholds),
            "usage": _usage_json(self.usage),
            "losses": asdict(self.losses),
            "first_code": [_use_json(use) for use in self.uses],
            "drift": self.drift and asdict(self.drift),
            "notes": self.notes,
        }

    def write_json(self, path: Path) -> Path:
        """Write `to_json` to a file, creating its folder."""
        return outcome.write_json(self.to_json(), path)


def diagnose(
    subject: Subject,
    training: ActionEpisodes | None,
    other: ActionEpisodes | None,
    thresholds: Thresholds,
    *,
    seed: int = 0,
) -> CodebookReport:
    """Code demonstrations and measure what the codes do, what they lose, and how other data differ.

    Args:
        subject: the tokenizer.
        training: what it was trained on, if that is here.
        other: further demonstrations; at least one of the two.
        thresholds: when to worry.
        seed: of the random choices of training episodes that drift is held against.

    Raises:
        DatasetError: no episode is half as long as a chunk.
    """
    demonstrations = training or other
    if demonstrations is None:
        raise ValueError("neither training nor other demonstrations")
    compares = training is not None and other is not None and not _same(training, other)
    coder = subject.coder
    coded = coder.code(cut_chunks(demonstrations, coder.timing))
    coded_other = coder.code(cut_chunks(other, coder.timing)) if compares and other is not None else None
    measure = measure_of({"names": list(demonstrations.names), "shape": (len(demonstrations.names),)})
    usage = measure_usage(coded.codes, coder.tokenizer.vocabulary)
    losses = measure_losses(coded, demonstrations, measure)
    drift = None
    if coded_other is not None and other is not None:
        drift = measure_drift(coded, coded_other, usage.vocabulary, other.folder, seed=seed)
    judgement = judge(subject, usage, losses, drift, thresholds)
    return CodebookReport(
        subject=subject,
        demonstrations=demonstrations,
        measure=measure,
        coded=coded,
        usage=usage,
        losses=losses,
        uses=uses_of_first_code(coded) if coder.tokenizer.coarse_to_fine else [],
        drift=drift,
        other=coded_other,
        thresholds=thresholds,
        judgement=Judgement(
            *outcome.with_untrained(judgement.verdict, judgement.reasons, untrained(subject.source))
        ),
        notes=[*_notes(subject, training, other), *_still(coded, demonstrations)],
    )


def _same(training: ActionEpisodes, other: ActionEpisodes) -> bool:
    return Path(training.folder).resolve() == Path(other.folder).resolve() and list(
        training.episodes
    ) == list(other.episodes)


def _notes(subject: Subject, training: ActionEpisodes | None, other: ActionEpisodes | None) -> list[str]:
    rules: list[tuple[bool, Callable[[], str]]] = [
        (not subject.coder.tokenizer.coarse_to_fine, lambda: BINS),
        (
            training is None,
            lambda: NOT_TRAINING_DATA.format(
                folder=subject.trained_on.folder or "it does not say where", given=other and other.folder
            ),
        ),
        (training is not None and other is not None and _same(training, other), lambda: SAME_DATA),
    ]
    return [note() for applies, note in rules if applies]


def _still(coded: CodedChunks, demonstrations: ActionEpisodes) -> list[str]:
    """Dimensions that are in no verdict."""
    names = [demonstrations.names[int(dim)] for dim in np.flatnonzero(~coded.chunks.moving)]
    return (
        [f"{len(names)} dimensions do not move beyond their noise, and do not count: {listed(names)}."]
        if names
        else []
    )


def _usage_json(usage: Usage) -> dict[str, Any]:
    return {
        "vocabulary": usage.vocabulary,
        "bits": usage.bits,
        "entropy_bits": usage.entropy_bits,
        "combinations": usage.combinations,
        "share_of_combinations": usage.share_of_combinations,
        "levels": [
            {"used": level.used, "perplexity": level.perplexity, "dead": level.dead, "counts": level.counts}
            for level in usage.levels
        ],
    }


def _use_json(use: CodeUse) -> dict[str, Any]:
    return {**asdict(use), "decoded": use.decoded.tolist()}
