"""The latest observations of each environment."""

import torch
from jaxtyping import Bool
from torch import Tensor

from lerobot_act_chunking.execution.environments import Environments


class ObservationHistory:
    """Keeps observations for windows of ``n_obs_steps``, in a ring of preallocated tensors.

    The window at step t holds the observations of t - (n_obs_steps - 1) * obs_stride, ..., t - obs_stride, t.
    As it may be asked for at every step, all observations in between are kept, too. The first observation
    after a reset stands in for those before it, as in LeRobot and Diffusion Policy (Chi et al. 2023);
    `is_pad` tells which ones.

    Args:
        n_obs_steps: H, observations in a window.
        obs_stride: control steps from each to the next.
    """

    def __init__(self, n_obs_steps: int, obs_stride: int = 1):
        self._ages = [step * obs_stride for step in reversed(range(n_obs_steps))]
        self._n_kept = self._ages[0] + 1
        self.reset()

    def reset(self, envs: Environments = None) -> None:
        """Forget the observations of these environments; all: equal to a fresh history."""
        if envs is None:
            self._ring: dict[str, Tensor] = {}  # (B, _n_kept, ...) each
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
                key: value[:, None].expand(-1, self._n_kept, *value.shape[1:]).clone()
                for key, value in observation.items()
            }
        self._newest = (self._newest + 1) % self._n_kept
        fresh = (self._seen == 0).nonzero()[:, 0]
        for key, ring in self._ring.items():
            ring[:, self._newest] = observation[key]
            if len(fresh):
                ring[fresh] = observation[key][fresh, None].expand_as(ring[fresh])
        self._seen = (self._seen + 1).clamp(max=self._n_kept)

    def stack(self, envs: Environments = None) -> dict[str, Tensor]:
        """Observations (n, H, ...) of these environments, oldest first."""
        places = [(self._newest - age) % self._n_kept for age in self._ages]
        return {
            key: ring[:, places] if envs is None else ring[envs][:, places]
            for key, ring in self._ring.items()
        }

    def is_pad(self, envs: Environments = None) -> Bool[Tensor, "n H"]:
        """Which of the stacked observations stand in for missing ones."""
        seen = self._seen if envs is None else self._seen[envs]
        return torch.tensor(self._ages) >= seen[:, None]
