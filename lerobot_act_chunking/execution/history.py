"""The latest observations of each environment."""

import torch
from jaxtyping import Bool
from torch import Tensor

from lerobot_act_chunking.execution.timeline import Environments


class ObservationHistory:
    """Keeps the latest ``n_obs_steps`` observations, in a ring of preallocated tensors.

    The first observation after a reset stands in for those before it, as in LeRobot and Diffusion Policy
    (Chi et al. 2023); `is_pad` tells which ones.

    Args:
        n_obs_steps: H, observations kept.
    """

    def __init__(self, n_obs_steps: int):
        self.n_obs_steps = n_obs_steps
        self.reset()

    def reset(self, envs: Environments = None) -> None:
        """Forget the observations of these environments; all: equal to a fresh history."""
        if envs is None:
            self._ring: dict[str, Tensor] = {}  # (B, H, ...) each
            self._seen = torch.zeros(0, dtype=torch.int64)  # (B,)
            self._newest = -1
        elif len(self._seen):
            self._seen[envs] = 0

    def push(self, observation: dict[str, Tensor]) -> None:
        """Add the observation (B, ...) of every environment; another batch size starts afresh."""
        batch_size = len(next(iter(observation.values())))
        if batch_size != len(self._seen):
            self.reset()
            self._seen = torch.zeros(batch_size, dtype=torch.int64)
            self._ring = {
                key: value[:, None].expand(-1, self.n_obs_steps, *value.shape[1:]).clone()
                for key, value in observation.items()
            }
        self._newest = (self._newest + 1) % self.n_obs_steps
        fresh = (self._seen == 0).nonzero()[:, 0]
        for key, ring in self._ring.items():
            ring[:, self._newest] = observation[key]
            if len(fresh):
                ring[fresh] = observation[key][fresh, None].expand_as(ring[fresh])
        self._seen = (self._seen + 1).clamp(max=self.n_obs_steps)

    def stack(self, envs: Environments = None) -> dict[str, Tensor]:
        """Observations (n, H, ...) of these environments, oldest first."""
        order = [(self._newest + 1 + i) % self.n_obs_steps for i in range(self.n_obs_steps)]
        return {
            key: ring[:, order] if envs is None else ring[envs][:, order] for key, ring in self._ring.items()
        }

    def is_pad(self, envs: Environments = None) -> Bool[Tensor, "n H"]:
        """Which of the stacked observations stand in for missing ones."""
        seen = self._seen if envs is None else self._seen[envs]
        return torch.arange(self.n_obs_steps) < self.n_obs_steps - seen[:, None]
