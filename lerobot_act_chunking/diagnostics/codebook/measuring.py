"""From a tokenizer and demonstrations to a `CodebookReport`."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from lerobot_act_chunking.diagnostics.codebook.chunks import CodedChunks, cut_chunks
from lerobot_act_chunking.diagnostics.codebook.drift import measure_drift
from lerobot_act_chunking.diagnostics.codebook.losses import measure_losses
from lerobot_act_chunking.diagnostics.codebook.meaning import uses_of_first_code
from lerobot_act_chunking.diagnostics.codebook.report import CodebookReport
from lerobot_act_chunking.diagnostics.codebook.settings import Thresholds
from lerobot_act_chunking.diagnostics.codebook.subject import Subject
from lerobot_act_chunking.diagnostics.codebook.usage import measure_usage
from lerobot_act_chunking.diagnostics.codebook.verdict import judge
from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes
from lerobot_act_chunking.diagnostics.core.measures import measure_of
from lerobot_act_chunking.diagnostics.core.noise_floor import listed
from lerobot_act_chunking.diagnostics.core.report import with_untrained
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


def measure(
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
    in_space = measure_of({"names": list(demonstrations.names), "shape": (len(demonstrations.names),)})
    usage = measure_usage(coded.codes, coder.tokenizer.vocabulary)
    losses = measure_losses(coded, demonstrations, in_space)
    drift = None
    if coded_other is not None and other is not None:
        drift = measure_drift(coded, coded_other, usage.vocabulary, other.folder, seed=seed)
    judgement = judge(subject, usage, losses, drift, thresholds)
    return CodebookReport(
        subject=subject,
        demonstrations=demonstrations,
        measure=in_space,
        coded=coded,
        usage=usage,
        losses=losses,
        uses=uses_of_first_code(coded) if coder.tokenizer.coarse_to_fine else [],
        drift=drift,
        other=coded_other,
        thresholds=thresholds,
        judgement=with_untrained(judgement, untrained(subject.source)),
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
