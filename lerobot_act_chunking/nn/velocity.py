"""Velocities of observed vectors, for data that record positions alone."""

from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor, nn

from lerobot_act_chunking.nn.processes import mean_over_processes

BATCHES_MEASURED = 100
LEAST_SCALE = 1e-3  # of one normalised unit: what moves less is noise, and is not blown up


class FiniteDifferences(nn.Module):
    """Differences between the observations of a window, each dimension in units of its usual size.

    Normalised observations of neighbouring steps differ by a hundredth of a unit, too little for a layer to
    notice. They are divided by their root mean square over the first `BATCHES_MEASURED` batches of training,
    which stays fixed afterwards and is saved with the weights. Normalisation is one affine map for all steps,
    so it cancels: the result is the raw velocity divided by the raw velocity's root mean square.

    Args:
        vector_dims: sizes of the vectors.
    """

    def __init__(self, vector_dims: Mapping[str, int]):
        super().__init__()
        self.dims = dict(vector_dims)
        self.mean_square: Tensor
        self.n_batches: Tensor
        self.register_buffer("mean_square", torch.ones(sum(self.dims.values())))
        self.register_buffer("n_batches", torch.tensor(0))

    @property
    def scale(self) -> Float[Tensor, " S"]:
        """Size of a usual difference of every dimension, vector by vector [normalised units]."""
        return self.mean_square.sqrt().clamp_min(LEAST_SCALE)

    def forward(self, vectors: Mapping[str, Float[Tensor, "B H _"]]) -> dict[str, Float[Tensor, "B H-1 _"]]:
        """Change from each step to the next, oldest first; zero where the first frame is repeated."""
        differences = torch.cat([vectors[key] for key in self.dims], dim=-1).diff(dim=1)
        if self.training:
            self._measure(differences.detach())
        return dict(zip(self.dims, (differences / self.scale).split([*self.dims.values()], -1), strict=True))

    @torch.no_grad()
    def _measure(self, differences: Float[Tensor, "B h S"]) -> None:
        """Let the batch count, if it is one of the first. Free of branches, so that it compiles."""
        counts = self.n_batches < BATCHES_MEASURED
        of_batch = mean_over_processes(differences.square().flatten(0, 1).mean(0))
        self.mean_square.lerp_(of_batch, counts / (self.n_batches + 1))
        self.n_batches += counts
