"""Text that every Python installation has: the documentation strings of its standard library."""

import ast
import sysconfig
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Int64
from torch import Tensor

from lerobot_act_chunking.diagnostics.lm_ablation.cells import Kind
from lerobot_act_chunking.errors import ConfigurationError, need
from lerobot_act_chunking.nn.language.text import Text
from lerobot_act_chunking.nn.language.weights import REQUIREMENT

LIBRARY = "tokenizers"  # of transformers
MOST_PIECES = 150_000
_LEFT_OUT = {"test", "tests", "idlelib", "site-packages", "lib2to3"}


class Tokenizer:
    """A language model's word pieces.

    Args:
        folder: with a ``tokenizer.json``.
        length: of every text; shorter ones are filled up.

    Raises:
        ConfigurationError: the library is not installed.
    """

    def __init__(self, folder: Path, length: int) -> None:
        library: Any = need(LIBRARY, "a language model's word pieces", REQUIREMENT)
        self._own = library.Tokenizer.from_file(str(folder / "tokenizer.json"))
        self._own.no_padding()
        self._own.no_truncation()
        self.length = length
        self.begin, self.end, self.mask = (
            self._own.token_to_id(name) for name in ("[CLS]", "[SEP]", "[MASK]")
        )

    def __call__(self, texts: list[str]) -> Text:
        """Instructions with ``[CLS]`` and ``[SEP]``.

        Raises:
            ConfigurationError: one is longer than ``length``.
        """
        rows = [each.ids for each in self._own.encode_batch(texts)]
        longest = max(range(len(rows)), key=lambda place: len(rows[place]))
        if len(rows[longest]) > self.length:
            raise ConfigurationError(
                f"the instruction {texts[longest]!r} has {len(rows[longest])} word pieces, more than "
                f"--text-tokens={self.length}: give --text-tokens={len(rows[longest])} and a new --output-dir"
            )
        return self._filled(rows)

    def pieces(self, text: str) -> list[int]:
        """Without ``[CLS]`` and ``[SEP]``."""
        return self._own.encode(text, add_special_tokens=False).ids

    def window(self, rows: Int64[np.ndarray, "B n"]) -> Text:
        """Texts of these word pieces."""
        return self._filled([[self.begin, *row, self.end] for row in rows.tolist()])

    def _filled(self, rows: list[list[int]]) -> Text:
        tokens = torch.zeros(len(rows), self.length, dtype=torch.int64)
        is_pad = torch.ones(len(rows), self.length, dtype=torch.bool)
        for place, row in enumerate(rows):
            tokens[place, : len(row)] = torch.tensor(row)
            is_pad[place, : len(row)] = False
        return Text(tokens, is_pad)


def read_corpus(tokenizer: Tokenizer, kind: Kind, rng: np.random.Generator) -> Int64[np.ndarray, " N"]:
    """Word pieces of the text, of the same in random order, or of a chain with the text's successors."""
    pieces: list[int] = []
    for text in _documentation():
        pieces += tokenizer.pieces(text)
        if len(pieces) >= MOST_PIECES:
            break
    found = np.array(pieces[:MOST_PIECES], np.int64)
    if kind == "shuffled":
        return rng.permutation(found)
    return _chain(found, rng) if kind == "markov" else found


def windows(corpus: Int64[np.ndarray, " N"], tokenizer: Tokenizer, n: int, rng: np.random.Generator) -> Text:
    """``n`` pieces of the corpus, each as long as the longest instruction."""
    length = tokenizer.length - 2
    starts = rng.integers(len(corpus) - length, size=n)
    return tokenizer.window(corpus[starts[:, None] + np.arange(length)])


def masked(text: Text, mask: int, generator: torch.Generator, share: float = 0.15) -> tuple[Text, Tensor]:
    """The text with some word pieces left out, and which ones (B, L)."""
    hidden = (torch.rand(text.tokens.shape, generator=generator) < share) & ~text.is_pad
    hidden[:, 0] = False
    hidden[:, 1] |= ~hidden.any(1)
    return Text(text.tokens.masked_fill(hidden, mask), text.is_pad), hidden


def _documentation() -> Iterator[str]:
    """Documentation strings, module by module in the order of their names."""
    library = Path(sysconfig.get_paths()["stdlib"])
    for path in sorted(library.rglob("*.py")):
        if _LEFT_OUT & {*path.relative_to(library).parts}:
            continue
        try:
            tree = ast.parse(path.read_text(encoding="utf-8"))
        except (SyntaxError, ValueError):
            continue
        for node in ast.walk(tree):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
                text = ast.get_docstring(node)
                if text:
                    yield " ".join(text.split())


def _chain(text: Int64[np.ndarray, " N"], rng: np.random.Generator) -> Int64[np.ndarray, " N"]:
    """Each word piece drawn from those that follow the one before it in the text."""
    successors: dict[int, list[int]] = defaultdict(list)
    for one, other in zip(text[:-1].tolist(), text[1:].tolist(), strict=True):
        successors[one].append(other)
    found = [int(text[0])]
    for draw in rng.random(len(text) - 1):
        following = successors.get(found[-1]) or text.tolist()
        found.append(following[int(draw * len(following))])
    return np.array(found, np.int64)
