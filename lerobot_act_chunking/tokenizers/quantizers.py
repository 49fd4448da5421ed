"""From vectors to codes, level by level, with `vector-quantize-pytorch`.

Every option is set, so that a new default of the library changes nothing.
"""

import math
from abc import abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor, nn

from lerobot_act_chunking.nn.processes import all_rows, own_rows


@dataclass(frozen=True)
class Quantized:
    """What became of a batch of encodings.

    Attributes:
        vectors: sums of the levels' codes; gradients pass through to the encodings.
        codes: one per level.
        commitment: mean squared distance of encodings to their codes, times its weight, summed over levels;
            of those that teach.
    """

    vectors: Float[Tensor, "N D"]
    codes: Int64[Tensor, "N G"]
    commitment: Float[Tensor, ""]


class Quantizer(nn.Module):
    """Residual quantisation: every level encodes what those before it have left.

    Attributes:
        n_codes: G, levels.
        vocabulary: M, codes of each.
    """

    n_codes: int
    vocabulary: int

    @abstractmethod
    def nearest(self, encodings: Float[Tensor, "N D"]) -> Int64[Tensor, "N G"]:
        """The codes of these encodings. No gradients; changes nothing."""

    @abstractmethod
    def vectors(self, codes: Int64[Tensor, "N G"]) -> Float[Tensor, "N D"]:
        """What codes stand for."""

    @abstractmethod
    def quantize(self, encodings: Float[Tensor, "N D"], teaches: Bool[Tensor, " N"], seed: int) -> Quantized:
        """Quantise a batch and, in training mode, learn from those of it that teach."""


class MovingCodebooks(Quantizer):
    """Codes that follow the encodings they stand for (van den Oord et al. 2017, appendix A.1).

    The codebook term of the loss, ``||sg(z) - e||^2``, is not descended but solved by moving averages of how
    many encodings a code has and of their sum; what is left for gradients is the commitment,
    ``beta ||z - sg(e)||^2``.

    Args:
        dim: D.
        n_levels: G.
        n_codes: M, codes per level.
        decay: gamma of the moving averages.
        commitment_weight: beta.
        kmeans_iters: k-means iterations over the first batch that place the codes; 0 for random codes.
        dead_code_threshold: codes with less than this share of what all would have if they were used alike
            (moving average) are placed anew on an encoding of the batch; 0 never.
        rotation_trick: pass gradients by the rotation from encoding to code, rather than straight.
    """

    def __init__(
        self,
        dim: int,
        n_levels: int,
        n_codes: int,
        *,
        decay: float,
        commitment_weight: float,
        kmeans_iters: int,
        dead_code_threshold: float,
        rotation_trick: bool,
    ):
        super().__init__()
        self.n_codes = n_levels
        self.vocabulary = n_codes
        self.dead_code_threshold = dead_code_threshold
        from vector_quantize_pytorch import ResidualVQ  # takes long: configurations import this module

        self.levels = ResidualVQ(
            dim=dim,
            num_quantizers=n_levels,
            codebook_size=n_codes,
            decay=decay,
            commitment_weight=commitment_weight,
            kmeans_init=kmeans_iters > 0,
            kmeans_iters=kmeans_iters,
            threshold_ema_dead_code=dead_code_threshold,  # pyright: ignore[reportArgumentType]  (see _revive_below)
            rotation_trick=rotation_trick,
            sync_codebook=False,  # `quantize` sees the encodings of all processes
            sync_kmeans=False,
            eps=1e-5,
            codebook_dim=dim,
            shared_codebook=False,
            diveq=False,
            heads=1,
            quantize_dropout=False,
            accept_image_fmap=False,
            accept_3d_fmap=False,
            channel_last=True,
            implicit_neural_codebook=False,
            beam_size=None,
            eval_beam_size=None,
            quant_grad_frac=0.0,
            separate_codebook_per_head=False,
            freeze_codebook=False,
            use_cosine_sim=False,
            layernorm_after_project_in=False,
            commitment_use_cross_entropy_loss=False,
            orthogonal_reg_weight=0.0,
            codebook_diversity_loss_weight=0.0,
            stochastic_sample_codes=False,
            sample_codebook_temp=1.0,
            straight_through=False,
            directional_reparam=False,
            ema_update=True,
            vq_bridge=None,
            manual_ema_update=False,
            learnable_codebook=False,
            in_place_codebook_optimizer=None,
            manual_in_place_optimizer_update=False,
            affine_param=False,
            sync_affine_param=False,
            sync_update_v=0.0,
            route_gradients_to_input=True,
            return_zeros_for_masked_padding=True,
        )

    def train(self, mode: bool = True) -> "MovingCodebooks":
        """Set the mode; the levels stay in training mode, without which they give no commitment loss.

        An argument of every call says whether they move.
        """
        super().train(mode)
        self.levels.train()
        return self

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> "MovingCodebooks":
        """Whether codes are placed is asked at every batch: it stays on the CPU (`CountsOnCpu`)."""
        placed = [each.initted for each in self._codebooks]
        super()._apply(fn, recurse)
        for codebook, each in zip(self._codebooks, placed, strict=True):
            codebook.initted = each
        return self

    @property
    def _codebooks(self) -> list[Any]:
        return [level._codebook for level in self.levels.layers]

    @property
    def is_placed(self) -> bool:
        """Whether the codes are where k-means, or chance, has put them."""
        return all(bool(codebook.initted) for codebook in self._codebooks)

    @torch.no_grad()
    def nearest(self, encodings: Float[Tensor, "N D"]) -> Int64[Tensor, "N G"]:
        """The codes of these encodings; before the first batch all codes are alike, and 0 the first."""
        if not self.is_placed:  # asking the levels would place them
            return encodings.new_zeros((len(encodings), self.n_codes), dtype=torch.int64)
        return self.levels(encodings[None], freeze_codebook=True)[1][0]

    def vectors(self, codes: Int64[Tensor, "N G"]) -> Float[Tensor, "N D"]:
        """The sums of these codes' vectors; the library's own look-up takes ten times as long."""
        levels = torch.arange(self.n_codes, device=codes.device)
        codebooks: Tensor = self.levels.codebooks  # pyright: ignore[reportAssignmentType]  (a property)
        return codebooks[levels, codes].sum(1)

    def quantize(self, encodings: Float[Tensor, "N D"], teaches: Bool[Tensor, " N"], seed: int) -> Quantized:
        """Quantise a batch by the codes as they are and, in training mode, then move them.

        The codes follow the encodings of all processes.
        """
        if self.training:
            encodings, teaches = all_rows(encodings), all_rows(teaches)
        n_teaching = int(teaches.sum()) if self.training else 0
        codes, commitment = self.nearest(encodings), encodings.new_zeros(())
        vectors = encodings + (self.vectors(codes) - encodings).detach()
        if n_teaching or (self.is_placed and teaches.any()):
            self._revive_below(self.dead_code_threshold * n_teaching / self.vocabulary)
            with seeded(seed, encodings.device):
                taught = self.levels(encodings[teaches][None], freeze_codebook=not n_teaching)
            vectors[teaches], codes[teaches], commitment = taught[0][0], taught[1][0], taught[2].sum()
        if self.training:
            vectors, codes = own_rows(vectors), own_rows(codes)
        return Quantized(vectors, codes, commitment)

    def _revive_below(self, count: float) -> None:
        """Place codes anew whose moving average of encodings per batch is below ``count``.

        The library takes a fixed count, below which in a small batch every code is.
        """
        for codebook in self._codebooks:
            codebook.threshold_ema_dead_code = codebook.reset_cluster_size = count


class FiniteScalar(Quantizer):
    """Every dimension of a short code rounded to a few values (Mentzer et al. 2023), nothing to collapse.

    There is neither codebook nor commitment: a linear map into the code and one out of it are learned with
    encoder and decoder.

    Args:
        dim: D.
        n_levels: G.
        values: number of values of each dimension of the code; M is their product.
    """

    def __init__(self, dim: int, n_levels: int, values: tuple[int, ...]):
        super().__init__()
        self.n_codes = n_levels
        self.vocabulary = math.prod(values)
        from vector_quantize_pytorch import ResidualFSQ

        with torch.device("cpu"):  # it computes while it is built, which the meta device cannot
            self.levels = ResidualFSQ(
                levels=list(values),
                num_quantizers=n_levels,
                dim=dim,
                is_channel_first=False,
                quantize_dropout=False,
                soft_clamp_input_value=None,
                bound_hard_clamp=True,
                num_codebooks=1,
                keep_num_codebooks_dim=False,
                scale=None,
                allowed_dtypes=(torch.float32, torch.float64),
                channel_first=False,
                projection_has_bias=True,
                return_indices=True,
                force_quantization_f32=True,
                noise_dropout=0.0,
                orthogonal_rotation=False,
            )

    @torch.no_grad()
    def nearest(self, encodings: Float[Tensor, "N D"]) -> Int64[Tensor, "N G"]:
        """The codes of these encodings."""
        return self.levels(encodings[None])[1][0].long()

    def vectors(self, codes: Int64[Tensor, "N G"]) -> Float[Tensor, "N D"]:
        """What these codes stand for; differentiable in the map out of them."""
        return self.levels.get_output_from_indices(codes[None])[0]

    def quantize(self, encodings: Float[Tensor, "N D"], teaches: Bool[Tensor, " N"], seed: int) -> Quantized:
        """Quantise a batch; nothing is drawn, and nothing moves but by gradients."""
        vectors, codes = self.levels(encodings[None])
        return Quantized(vectors[0], codes[0].long(), encodings.new_zeros(()))


@contextmanager
def seeded(seed: int, device: torch.device) -> Iterator[None]:
    """Draws on the CPU and on ``device`` follow from ``seed``; afterwards the generators are as before."""
    on_gpu = device.type == "cuda"
    with torch.random.fork_rng(devices=[device] if on_gpu else [], device_type="cuda"):
        torch.set_rng_state(torch.Generator().manual_seed(seed).get_state())
        if on_gpu:
            torch.cuda.set_rng_state(torch.Generator(device).manual_seed(seed).get_state(), device)
        yield
