"""Randomness of training that a resumed run goes on with."""

import numpy as np
import torch
from torch import Tensor

from lerobot_act_chunking.nn.buffers import CountsOnCpu, keep_missing_buffers
from lerobot_act_chunking.nn.processes import of_first_process

EVALUATION_SEED = 0


class BatchSeeds(CountsOnCpu):
    """A seed for every batch, which follows from the run and the number of batches before it.

    Both are saved with the weights. LeRobot restores PyTorch's global generator on resuming, too, but its new
    data loader draws from it before the policy can. In evaluation mode every batch gets the same seed: losses
    of different checkpoints then differ by their weights alone. A checkpoint without them begins anew.
    """

    counts = ("seed", "n_batches")

    def __init__(self):
        super().__init__()
        self.seed: Tensor
        self.n_batches: Tensor
        self.register_buffer("seed", torch.tensor(-1))  # drawn from the global generator on first use
        self.register_buffer("n_batches", torch.tensor(0))
        self.register_load_state_dict_pre_hook(keep_missing_buffers)

    def next_seed(self) -> int:
        """The seed of the next batch, the same in all processes: each draws its own rows of what follows."""
        if not self.training:
            return EVALUATION_SEED
        if int(self.seed) < 0:
            self.seed.fill_(of_first_process(int(torch.randint(2**62, ()))))
        entropy = (int(self.seed), int(self.n_batches), 0)
        self.n_batches += 1
        return int(np.random.SeedSequence(entropy).generate_state(1, np.uint64)[0])

    def next_generator(self, device: torch.device) -> torch.Generator:
        """A generator with the seed of the next batch."""
        return torch.Generator(device).manual_seed(self.next_seed())
