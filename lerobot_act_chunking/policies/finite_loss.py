"""Training stops at a loss that is not finite, with the input that made it so."""

import math
from collections.abc import Iterable, Mapping
from typing import Any

import torch
from torch import Tensor

from lerobot_act_chunking.data.batch import first_non_finite
from lerobot_act_chunking.errors import DatasetError

UNUSUAL = 1e4
"""Normalised inputs are of the order of one; beyond this the data are to blame, not the weights."""


def finite_terms(
    loss: Tensor,
    terms: Mapping[str, Tensor | float],
    batch: Mapping[str, Any],
    keys: Iterable[str],
    *,
    rate: str = "optimizer_lr",
) -> dict[str, float]:
    """The terms of a loss as plain numbers, all read at once: each reading would wait for the device.

    Args:
        loss: of any shape.
        terms: its terms; those that are plain numbers already stay as they are.
        batch: what it was computed from ...
        keys: ... and what of that was read.
        rate: the setting that decides how fast what is learning learns.

    Raises:
        DatasetError: the loss or a term is NaN or infinite, naming the input that is to blame or, if none is,
            the learning rate.
    """
    unread = {name: each.detach() for name, each in terms.items() if isinstance(each, Tensor)}
    *numbers, total = torch.stack([*unread.values(), loss.detach().sum()]).tolist()
    found = {**terms, **dict(zip(unread, numbers, strict=True))}
    if not all(map(math.isfinite, (*found.values(), total))):
        raise DatasetError(f"the loss is not finite ({found}); {_cause(batch, list(keys), rate)}")
    return found


def require_finite_actions(actions: Tensor) -> None:
    """Refuse demonstrated actions for which no code can stand.

    Raises:
        DatasetError: one of them is NaN or infinite.
    """
    if not torch.isfinite(actions).all():
        raise DatasetError(f"no loss can be computed; {_spoiled('action')}")


def _cause(batch: Mapping[str, Any], keys: list[str], rate: str) -> str:
    spoiled = first_non_finite(batch, keys)
    if spoiled is not None:
        return _spoiled(spoiled)
    largest = {key: float(batch[key].float().abs().max()) for key in keys}
    key = max(largest, key=largest.__getitem__)
    if largest[key] > UNUSUAL:
        return (
            f"{key!r} in the batch reaches {largest[key]:.3g} where normalised values are of the order of 1: "
            "check the dataset and its statistics"
        )
    return f"all inputs are finite: the weights have diverged, lower --policy.{rate}"


def _spoiled(key: str) -> str:
    return f"{key!r} in the batch holds a NaN or an infinity: check the dataset"
