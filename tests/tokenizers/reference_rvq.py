"""Residual vector quantisation with EMA updates, written down once more in the plainest way."""

import torch

SMOOTHING = 1e-5  # Laplace


class ReferenceRvq:
    """Codebooks e of several levels, moved by averages of counts N and sums s.

        loss = ||sg(z) - e||^2 + beta ||z - sg(e)||^2

    The first term is not descended: its minimiser, the mean of the encodings of a code, is followed by
    N <- gamma N + (1 - gamma) n,  s <- gamma s + (1 - gamma) sum z,  e = s / N.
    """

    def __init__(self, codebooks, *, decay, beta):
        self.codebooks = [codebook.clone() for codebook in codebooks]
        self.counts = [torch.ones(len(codebook)) for codebook in codebooks]
        self.sums = [codebook.clone() for codebook in codebooks]
        self.decay = decay
        self.beta = beta

    def quantize(self, z):
        """Sums of codes (N, D), codes (N, G) and commitment of encodings (N, D); then moves the codebooks."""
        quantized, commitment, codes = 0, 0, []
        residual = z
        for level, codebook in enumerate(self.codebooks):
            code = (residual[:, None] - codebook).square().sum(-1).argmin(1)
            nearest = codebook[code]
            commitment = commitment + self.beta * (residual - nearest).square().mean()
            # Straight through, on every level: z receives the decoder's gradient once per level.
            quantized = quantized + residual + (nearest - residual).detach()
            codes.append(code)
            self._move(level, residual.detach(), code)
            residual = residual - nearest
        return quantized, torch.stack(codes, 1), commitment

    def _move(self, level, z, code):
        taken = torch.nn.functional.one_hot(code, len(self.codebooks[level])).to(z.dtype)
        self.counts[level] = self.decay * self.counts[level] + (1 - self.decay) * taken.sum(0)
        self.sums[level] = self.decay * self.sums[level] + (1 - self.decay) * taken.T @ z
        total = self.counts[level].sum()
        n = (self.counts[level] + SMOOTHING) / (total + len(taken.T) * SMOOTHING) * total
        self.codebooks[level] = self.sums[level] / n[:, None]
