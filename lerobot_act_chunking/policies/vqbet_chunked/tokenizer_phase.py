"""When a policy's tokenizer learns, and what of that belongs into a checkpoint."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from lerobot_act_chunking.policies.batch_seeds import BatchSeeds
from lerobot_act_chunking.tokenizers.tokenizer import ActionTokenizer, Reconstruction


class TokenizerPhase(BatchSeeds):
    """Counts the batches that the tokenizer has learned from; saved with the weights, as LeRobot's is not.

    Args:
        n_steps: batches that the tokenizer learns from before the policy does; 0 if it needs none.
        joint: it goes on learning beside the policy, to the end.
    """

    counts = (*BatchSeeds.counts, "n_learned")

    def __init__(self, n_steps: int, *, joint: bool):
        super().__init__()
        self.n_steps = n_steps
        self.joint = joint
        self.n_learned: Tensor
        self.register_buffer("n_learned", torch.tensor(0))

    @property
    def comes_first(self) -> bool:
        """Whether the tokenizer learns alone, for now."""
        return self.n_left > 0

    @property
    def n_left(self) -> int:
        """Batches that the tokenizer has yet to learn from before the policy does."""
        return max(0, self.n_steps - int(self.n_learned))

    def learn(
        self, tokenizer: ActionTokenizer, chunks: Float[Tensor, "N C A"], is_pad: Bool[Tensor, "N C"]
    ) -> Reconstruction:
        """One batch for the tokenizer."""
        reconstruction = tokenizer.learn(chunks, is_pad, self.next_seed())
        if self.training:
            self.n_learned += 1
        return reconstruction
