"""A tokenizer with the units it works in."""

from dataclasses import dataclass

import torch
from torch import Tensor

from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.diagnostics.codebook.chunks import CodedChunks, DemonstratedChunks
from lerobot_act_chunking.diagnostics.codebook.scale import ActionScale
from lerobot_act_chunking.tokenizers.tokenizer import ActionTokenizer

CHUNKS_AT_ONCE = 4096


@dataclass(frozen=True)
class ChunkCoder:
    """Codes chunks of raw actions.

    Attributes:
        tokenizer: works on normalised chunks.
        scale: its normalisation.
        timing: which steps a chunk holds.
    """

    tokenizer: ActionTokenizer
    scale: ActionScale
    timing: ChunkTiming

    @torch.no_grad()
    def code(self, chunks: DemonstratedChunks) -> CodedChunks:
        """The chunks' codes, and what these stand for."""
        self.tokenizer.eval()
        normalised = self.scale.normalised(chunks.actions)
        parts = [self._through(part) for part in normalised.split(CHUNKS_AT_ONCE)]
        codes, decoded = (torch.cat(part) for part in zip(*parts, strict=True))
        valid = torch.from_numpy(~chunks.is_pad)[..., None]
        squares = (decoded - normalised) ** 2 * valid
        return CodedChunks(
            chunks=chunks,
            codes=codes.numpy(),
            decoded=self.scale.raw(decoded),
            lost=(squares.sum(1) / valid.sum(1)).numpy(),
            varies=normalised[~torch.from_numpy(chunks.is_pad)].var(0, correction=0).numpy(),
        )

    def _through(self, normalised: Tensor) -> tuple[Tensor, Tensor]:
        device = next(iter((*self.tokenizer.parameters(), *self.tokenizer.buffers())), normalised).device
        codes = self.tokenizer.encode(normalised.to(device))
        return codes.cpu(), self.tokenizer.decode(codes).cpu()
