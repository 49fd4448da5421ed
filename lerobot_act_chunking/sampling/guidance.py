"""Classifier-free guidance: towards what a condition adds, such as an instruction or a goal."""

import torch
from jaxtyping import Float
from torch import Tensor

from lerobot_act_chunking.sampling.solvers import Denoise


def classifier_free(denoise: Denoise, scale: float) -> Denoise:
    """Go from the estimate without the condition to the one with it, and on (Ho & Salimans 2022, eq. 6).

    As on the noise, so on the clean actions: both are affine in each other at a given x. The result may leave
    the range of the actions, so clipping belongs around it.

    Args:
        denoise: of a doubled batch: rows 0 ... B - 1 with the condition, rows B ... 2B - 1 without.
        scale: 0 leaves the condition out, 1 is the estimate with it (then there is no need to double), more
            exaggerates it.
    """

    def guided(x: Float[Tensor, "B T A"], i: int) -> Float[Tensor, "B T A"]:
        conditional, unconditional = denoise(torch.cat([x, x]), i).chunk(2)
        return unconditional + scale * (conditional - unconditional)

    return guided
