"""The random draws of training, which a resumed run goes on with."""

import numpy as np
import torch
from torch import Tensor, nn

EVALUATION_SEED = 0


class TrainingNoise(nn.Module):
    """A generator for every batch, whose seed follows from the run and the number of batches before it.

    Both are saved with the weights. LeRobot restores PyTorch's global generator on resuming, too, but its new
    data loader draws from it before the policy can. In evaluation mode every batch gets the same draws: losses
    of different checkpoints then differ by their weights alone.
    """

    def __init__(self):
        super().__init__()
        self.seed: Tensor
        self.n_batches: Tensor
        self.register_buffer("seed", torch.tensor(-1))  # drawn from the global generator on first use
        self.register_buffer("n_batches", torch.tensor(0))

    def generator(self, device: torch.device) -> torch.Generator:
        """The generator of the next batch; ranks of a distributed run have different ones."""
        if not self.training:
            return torch.Generator(device).manual_seed(EVALUATION_SEED)
        if self.seed < 0:
            self.seed.fill_(int(torch.randint(2**62, ())))
        rank = torch.distributed.get_rank() if torch.distributed.is_initialized() else 0
        mixed = np.random.SeedSequence((int(self.seed), int(self.n_batches), rank)).generate_state(1, np.uint64)
        self.n_batches += 1
        return torch.Generator(device).manual_seed(int(mixed[0]))
