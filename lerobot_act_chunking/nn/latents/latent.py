"""What every latent does: draw a style from the posterior in training, and from the prior when acting."""

from abc import ABC, abstractmethod
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from lerobot_act_chunking.nn.latents.spec import LatentSpec


class Posterior(NamedTuple):
    """A style drawn from q(z | demonstration).

    Attributes:
        z: the sample (B, L), through which gradients reach the encoder.
        divergence: KL(q || prior) [nats] (B, J): of each dimension where the prior is independent over them,
            else of all together (J = 1).
        mean: of q (B, L); for a categorical latent, the probabilities of its codes.
    """

    z: Float[Tensor, "B L"]
    divergence: Float[Tensor, "B J"]
    mean: Float[Tensor, "B L"]


class Latent(nn.Module, ABC):
    """A latent variable with its prior.

    All randomness is standard normal numbers that the caller passes in.

    Attributes:
        dim: width L of z.
        n_parameters: numbers P of the posterior, which the style encoder gives.
        n_noise: standard normal numbers that one z consumes.
    """

    dim: int
    n_parameters: int
    n_noise: int

    @classmethod
    @abstractmethod
    def from_spec(cls, spec: LatentSpec, token_dim: int) -> "Latent":
        """A fresh latent with these settings, for tokens of ``token_dim`` channels."""

    def posterior(
        self,
        parameters: Float[Tensor, "B P"],
        noise: Float[Tensor, "B n"],
        tokens: Float[Tensor, "B N D"],
    ) -> Posterior:
        """A style of each demonstration. In training mode it may also count and remember what it sees.

        Args:
            parameters: of the posterior, from the style encoder.
            noise: standard normal.
            tokens: of the observation.
        """
        single = torch.promote_types(parameters.dtype, torch.float32)  # exponentials, also under autocast
        return self._posterior(parameters.to(single), noise.to(single), tokens)

    @abstractmethod
    def _posterior(
        self,
        parameters: Float[Tensor, "B P"],
        noise: Float[Tensor, "B n"],
        tokens: Float[Tensor, "B N D"],
    ) -> Posterior: ...

    @abstractmethod
    def prior(
        self, noise: Float[Tensor, "B n"] | None, tokens: Float[Tensor, "B N D"]
    ) -> Float[Tensor, "B L"]:
        """Styles for acting: samples made from standard normal ``noise``, or the mode if that is None."""
