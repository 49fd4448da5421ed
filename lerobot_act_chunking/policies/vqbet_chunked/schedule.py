"""The learning rate of a run that first trains its tokenizer."""

import math
from dataclasses import dataclass
from pathlib import Path

from lerobot.optim.schedulers import LRSchedulerConfig
from safetensors import safe_open
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LambdaLR

from lerobot_act_chunking.errors import ConfigurationError

N_LEARNED = "tokenizer_phase.n_learned"
"""Where a checkpoint counts the batches that its tokenizer has learned from."""


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
        """The schedule as a factor of each parameter group's rate.

        Raises:
            ConfigurationError: the run is over before the policy learns.
        """
        self._check_policy_learns(num_training_steps)
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

    def _check_policy_learns(self, num_training_steps: int) -> None:
        """LeRobot tells here, for the first time, how long the run is."""
        if num_training_steps > self.num_tokenizer_steps:
            return
        shorter = num_training_steps // 2
        raise ConfigurationError(
            f"steps={num_training_steps} are over before the policy learns: its tokenizer learns alone for "
            f"the first {self.num_tokenizer_steps} (n_vqvae_training_steps); set --steps to more than "
            f"{self.num_tokenizer_steps}"
            + (f", or --policy.n_vqvae_training_steps={shorter}" if shorter else "")
        )


def steps_left(n_steps: int, checkpoint: Path | None) -> int:
    """Of a tokenizer's ``n_steps``, those that remain when a run starts from a checkpoint's weights.

    None remain after a checkpoint that is not a folder with weights (an adapter, a name on a hub): only a run
    that was interrupted while its tokenizer learned leaves one with steps to go.
    """
    if checkpoint is None:
        return n_steps
    weights = Path(checkpoint) / "model.safetensors"
    if not weights.is_file():
        return 0
    with safe_open(weights, framework="pt") as file:
        learned = int(file.get_tensor(N_LEARNED)) if N_LEARNED in file.keys() else n_steps  # noqa: SIM118
    return max(0, n_steps - learned)
