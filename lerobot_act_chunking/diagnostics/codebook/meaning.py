"""What each value of the first code does: which motions it stands for, how often and when."""

from dataclasses import dataclass

import numpy as np

from lerobot_act_chunking.diagnostics.codebook.chunks import CodedChunks

MOST_CODES = 12
EXAMPLES = 8
TENTHS = 10


@dataclass(frozen=True)
class CodeUse:
    """One value of the first code.

    Attributes:
        code: the value.
        share: of all chunks.
        combinations: different codes that occur behind it.
        progress: 10th, 50th and 90th percentile of where in the episode (0 to 1) its chunks begin.
        timeline: share of the chunks of each tenth of the episodes that have it.
        decoded: (n, C, A) what its most frequent combinations stand for, in raw units, the first one first.
    """

    code: int
    share: float
    combinations: int
    progress: tuple[float, float, float]
    timeline: list[float]
    decoded: np.ndarray


def uses_of_first_code(coded: CodedChunks) -> list[CodeUse]:
    """The values in use, the most frequent first."""
    values, counts = np.unique(coded.codes[:, 0], return_counts=True)
    tenth = np.minimum((coded.chunks.progress * TENTHS).astype(int), TENTHS - 1)
    all_by_tenth = np.bincount(tenth, minlength=TENTHS)
    return [
        _use(coded, int(code), tenth, all_by_tenth) for code in values[np.argsort(-counts, kind="stable")]
    ]


def _use(coded: CodedChunks, code: int, tenth: np.ndarray, all_by_tenth: np.ndarray) -> CodeUse:
    rows = np.flatnonzero(coded.codes[:, 0] == code)
    _, first, counts = np.unique(coded.codes[rows], axis=0, return_index=True, return_counts=True)
    frequent = rows[first[np.argsort(-counts, kind="stable")[:EXAMPLES]]]
    low, middle, high = np.percentile(coded.chunks.progress[rows], [10, 50, 90]).tolist()
    by_tenth = np.bincount(tenth[rows], minlength=TENTHS) / np.maximum(all_by_tenth, 1)
    return CodeUse(
        code=code,
        share=len(rows) / len(coded.codes),
        combinations=len(counts),
        progress=(low, middle, high),
        timeline=by_tenth.tolist(),
        decoded=coded.decoded[frequent],
    )
