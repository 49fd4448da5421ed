"""The plan in execution, as a new chunk sees it."""

import math
import warnings
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor


@dataclass(frozen=True)
class Plan:
    """Actions that are already planned for the steps that a new chunk predicts.

    Attributes:
        actions: (n, T, A), normalised; the last planned action is repeated behind the end of the plan.
        covered: (n, T), the steps that the plan reaches; none for an environment without a plan.
        n_frozen: predictions that come too late: they are executed from the plan while the chunk is computed.
    """

    actions: Float[Tensor, "n T A"]
    covered: Bool[Tensor, "n T"]
    n_frozen: int

    @classmethod
    def from_steps(
        cls,
        steps: Float[Tensor, "n P A"],
        covered: Bool[Tensor, "r P"],
        *,
        horizon: int,
        chunk_stride: int,
        delay: int,
    ) -> "Plan | None":
        """The plan at the predicted steps; None if it covers none of them.

        Args:
            steps: planned actions from the current control step on.
            covered: which of them there are; one row for all environments, or one for each.
            horizon: T, predictions of a chunk.
            chunk_stride: control steps between them.
            delay: control steps until the new chunk is used.
        """
        at = torch.arange(0, horizon * chunk_stride, chunk_stride)
        reached = covered.to("cpu").expand(len(steps), -1).cumprod(1).bool()  # a plan ends at its first gap
        if not reached.any():
            return None
        within = reached[:, at.clamp(max=reached.shape[1] - 1)] & (at < reached.shape[1])
        last = (reached.sum(1, keepdim=True) - 1).clamp_min(0)
        source = torch.minimum(at, last).to(steps.device)
        actions = steps.gather(1, source[..., None].expand(-1, -1, steps.shape[2]))
        return cls(actions, within.to(steps.device), min(math.ceil(delay / chunk_stride), horizon))

    @property
    def frozen(self) -> Bool[Tensor, "n T"]:
        """The predictions that are executed from the plan in any case."""
        steps = torch.arange(self.covered.shape[1], device=self.covered.device)
        return self.covered & (steps < self.n_frozen)

    def whole_tokens(self, actions_per_token: int, longest: int) -> "Plan":
        """With frozen actions that fill whole tokens, at most ``longest``, as training has shown."""
        n_tokens = math.ceil(self.n_frozen / actions_per_token)
        if n_tokens > longest:
            warnings.warn(
                f"the chunk is late for {n_tokens} tokens of {actions_per_token} actions, but training "
                f"(prefix_steps) has given it at most {longest}: it is conditioned on no more",
                stacklevel=2,
            )
        return replace(self, n_frozen=min(n_tokens, longest) * actions_per_token)

    def repeat(self, n_samples: int) -> "Plan":
        """The same plan for every one of ``n_samples`` samples of each environment, sample by sample."""
        if n_samples == 1:
            return self
        return Plan(self.actions.repeat(n_samples, 1, 1), self.covered.repeat(n_samples, 1), self.n_frozen)


def covered_steps(plan: Float[Tensor, "n P A"]) -> Bool[Tensor, "n P"]:
    """The steps that are plan, not padding: those up to the last one with any value but zero.

    LeRobot's engine fills up what is left of a chunk with zeros, and RTCProcessor guides towards them.
    """
    present = plan.ne(0).any(-1)
    return present.flip(1).cummax(1).values.flip(1)
