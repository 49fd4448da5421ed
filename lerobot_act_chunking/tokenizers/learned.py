"""Chunks encoded, quantised and decoded by what is learned from them."""

from typing import ClassVar

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor, nn

from lerobot_act_chunking.errors import look_up
from lerobot_act_chunking.nn.processes import counted_together
from lerobot_act_chunking.ranges import check_ranges
from lerobot_act_chunking.tokenizers.coders import CODERS, make_coders
from lerobot_act_chunking.tokenizers.quantizers import Quantizer
from lerobot_act_chunking.tokenizers.spec import TokenizerSpec
from lerobot_act_chunking.tokenizers.tokenizer import ActionTokenizer, Reconstruction

COMMITMENT = 5.0
"""Weight of the commitment beside the L1 error of the reconstruction (the official VQ-BeT code)."""
MOST_PADDING = 0.5
"""Share of a chunk that may be padding for it to teach."""


class LearnedTokenizer(ActionTokenizer):
    """Encoder, residual quantiser, decoder, as in VQ-BeT (Lee et al. 2024, section 3.2).

    Everything computes in single precision, also under autocast: a code must not depend on it.
    """

    settings: ClassVar[tuple[str, ...]] = (
        "vqvae_num_layers",
        "vqvae_embedding_dim",
        "vqvae_enc_hidden_dim",
        "vqvae_coder",
    )
    coarse_to_fine: ClassVar[bool] = True
    is_learned: ClassVar[bool] = True
    is_bounded: ClassVar[bool] = False

    def __init__(self, encoder: nn.Module, decoder: nn.Module, quantizer: Quantizer):
        super().__init__()
        self.encoder = encoder
        self.decoder = decoder
        self.quantizer = quantizer
        self.n_codes = quantizer.n_codes
        self.vocabulary = quantizer.vocabulary

    @classmethod
    def check(cls, spec: TokenizerSpec) -> None:
        """Refuse an encoder and a decoder that cannot work.

        Raises:
            ConfigurationError: naming the value and the way out.
        """
        look_up("vqvae_coder", spec.vqvae_coder, CODERS)
        check_ranges(spec, "vqvae_num_layers", "vqvae_embedding_dim", "vqvae_enc_hidden_dim")

    @staticmethod
    def coders(spec: TokenizerSpec) -> tuple[nn.Module, nn.Module]:
        """A fresh encoder and its decoder."""
        return make_coders(
            spec.vqvae_coder,
            spec.chunk_size,
            spec.action_dim,
            dim=spec.vqvae_embedding_dim,
            hidden_dim=spec.vqvae_enc_hidden_dim,
        )

    @torch.no_grad()
    def encode(self, actions: Float[Tensor, "N C A"]) -> Int64[Tensor, "N G"]:
        """The codes of these chunks."""
        with torch.autocast(actions.device.type, enabled=False):
            return self.quantizer.nearest(self.encoder(actions.float()))

    def decode(self, codes: Int64[Tensor, "N G"]) -> Float[Tensor, "N C A"]:
        """The chunks that these codes stand for."""
        with torch.autocast(codes.device.type, enabled=False):
            return self.decoder(self.quantizer.vectors(codes))

    def learn(
        self, actions: Float[Tensor, "N C A"], is_pad: Bool[Tensor, "N C"], seed: int
    ) -> Reconstruction:
        """The L1 error plus the commitment; chunks that are mostly padding have loss zero."""
        teaches = is_pad.float().mean(1) <= MOST_PADDING
        with torch.autocast(actions.device.type, enabled=False):
            encodings = self.encoder(actions.float())
            quantized = self.quantizer.quantize(encodings, teaches, seed)
            decoded = self.decoder(quantized.vectors)
        error = _error_per_chunk((decoded - actions).abs(), teaches[:, None] & ~is_pad)
        commitment = (
            quantized.commitment * teaches * (len(teaches) / counted_together(teaches.sum()).clamp_min(1))
        )
        taught = quantized.codes[teaches]
        return Reconstruction(
            loss=error + COMMITMENT * commitment,
            actions=decoded,
            codes=quantized.codes,
            metrics={
                "reconstruction_l1": error.mean().item(),
                "commitment": quantized.commitment.item(),
                "used_codes": _shares(taught, self.vocabulary).gt(0).sum(-1).float().mean().item(),
                "code_perplexity": perplexity(taught, self.vocabulary).mean().item(),
            },
        )


def perplexity(codes: Int64[Tensor, "N G"], vocabulary: int) -> Float[Tensor, " G"]:
    """Of each level, how many equally frequent codes would be as unpredictable: between 1 and M."""
    return torch.special.entr(_shares(codes, vocabulary)).sum(-1).exp()


def _shares(codes: Int64[Tensor, "N G"], vocabulary: int) -> Float[Tensor, "G M"]:
    """How often each code of each level occurs."""
    return nn.functional.one_hot(codes, vocabulary).sum(0) / max(1, len(codes))


def _error_per_chunk(error: Float[Tensor, "N C A"], counts: Bool[Tensor, "N C"]) -> Float[Tensor, " N"]:
    """Errors of the steps that count, scaled so that their mean is the mean over all those of the batch."""
    total = (error * counts[..., None]).sum((1, 2))
    n_counting = counted_together(counts.sum() * error.shape[-1])
    return total * len(counts) / n_counting.clamp_min(1)
