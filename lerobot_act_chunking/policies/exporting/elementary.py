"""What ONNX has no operator for, in elementary operations and single precision."""

import torch
from jaxtyping import Float
from torch import Tensor

CENTRAL, FAR = 0.425, 5.0  # where one approximation hands over to the next
_CENTRE = (
    (59.10937472, 159.29113202, 50.434271938, 3.3871327179),
    (67.1875636, 78.757757664, 17.895169469, 1.0),
)
_TAIL = (
    (0.17023821103, 1.3067284816, 2.75681539, 1.4234372777),
    (0.12021132975, 0.7370016425, 1.0),
)
_FAR_TAIL = (
    (0.017337203997, 0.42868294337, 3.081226386, 6.657905115),
    (0.012258202635, 0.24197894225, 1.0),
)


def normal_quantile(probability: Float[Tensor, "*S"]) -> Float[Tensor, "*S"]:
    """`torch.special.ndtri`, for probabilities in (0, 1) (Wichura 1988, AS 241)."""
    centred = probability - 0.5
    central = centred * _ratio(CENTRAL**2 - centred.square(), _CENTRE)
    depth = torch.minimum(probability, 1 - probability).log().neg().sqrt()
    outer = torch.where(depth <= FAR, _ratio(depth - 1.6, _TAIL), _ratio(depth - FAR, _FAR_TAIL))
    return torch.where(centred.abs() <= CENTRAL, central, outer * centred.sign())


def stable_sort(
    x: Float[Tensor, "*S"], *, stable: bool | None = None, dim: int = -1, descending: bool = False
) -> tuple[Tensor, Tensor]:
    """`torch.sort` of equal numbers in their order, which ONNX's operator for the largest ones keeps."""
    return torch.topk(x, x.shape[dim], dim, largest=descending)


def next_below(x: Float[Tensor, "*S"], _towards: Tensor) -> Float[Tensor, "*S"]:
    """`torch.nextafter` from positive numbers towards zero: a factor that rounds down by one place."""
    return x * (1 - 2**-24)


def _ratio(x: Tensor, coefficients: tuple[tuple[float, ...], tuple[float, ...]]) -> Tensor:
    above, below = (_polynomial(x, each) for each in coefficients)
    return above / below


def _polynomial(x: Tensor, coefficients: tuple[float, ...]) -> Tensor:
    value = torch.zeros_like(x)
    for coefficient in coefficients:
        value = value * x + coefficient
    return value
