"""The learning rate of a run that first trains its tokenizer."""

import math
from dataclasses import dataclass

from lerobot.optim.schedulers import LRSchedulerConfig
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LambdaLR


@LRSchedulerConfig.register_subclass("tokenizer_then_policy")
@dataclass
class TokenizerThenPolicySchedulerConfig(LRSchedulerConfig):
    """Constant while the tokenizer learns; then linear warm-up and, if asked for, a cosine to zero.

    LeRobot's scheduler for VQ-BeT counts the tokenizer's steps into the cosine, which so never gets to zero.

    Attributes:
        num_warmup_steps: of the policy.
        num_tokenizer_steps: before them.
        cosine: decay over the steps that remain.
    """

    num_warmup_steps: int  # pyright: ignore[reportIncompatibleVariableOverride]  (as LeRobot's own)
    num_tokenizer_steps: int
    cosine: bool

    def build(self, optimizer: Optimizer, num_training_steps: int) -> LambdaLR:
        """The schedule as a factor of each parameter group's rate."""
        decaying = max(1, num_training_steps - self.num_tokenizer_steps - self.num_warmup_steps)

        def factor(step: int) -> float:
            step -= self.num_tokenizer_steps
            if step < 0:
                return 1.0
            if step < self.num_warmup_steps:
                return step / self.num_warmup_steps
            if not self.cosine:
                return 1.0
            return 0.5 * (1 + math.cos(math.pi * min(1.0, (step - self.num_warmup_steps) / decaying)))

        return LambdaLR(optimizer, factor)
