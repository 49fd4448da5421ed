"""An instruction as a language model reads it."""

from typing import NamedTuple

import torch.nn.functional as F  # noqa: N812
from jaxtyping import Bool, Int64
from torch import Tensor


class Text(NamedTuple):
    """Instructions in word pieces, ``[CLS]`` and ``[SEP]`` included.

    Attributes:
        tokens: numbers of the word pieces.
        is_pad: which of them only fill up shorter instructions.
    """

    tokens: Int64[Tensor, "B L"]
    is_pad: Bool[Tensor, "B L"]

    def repeat(self, n_samples: int) -> "Text":
        """The same ``n_samples`` times, one copy behind the other."""
        return Text(self.tokens.repeat(n_samples, 1), self.is_pad.repeat(n_samples, 1))

    def filled_up(self, length: int) -> "Text":
        """With padding up to so many word pieces."""
        missing = (0, length - self.tokens.shape[1])
        return Text(F.pad(self.tokens, missing), F.pad(self.is_pad, missing, value=True))
