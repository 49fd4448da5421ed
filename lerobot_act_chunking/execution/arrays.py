"""Tensors as NumPy arrays, for what is computed without PyTorch."""

import numpy as np
import torch
from torch import Tensor


def array_of(tensor: Tensor) -> np.ndarray:
    """The numbers of a tensor on any device; those of half precision, which NumPy may not know, in single."""
    return tensor.detach().to("cpu", torch.promote_types(tensor.dtype, torch.float32)).numpy()
