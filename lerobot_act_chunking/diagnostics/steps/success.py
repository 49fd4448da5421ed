"""The last word: episodes in simulation, by number of steps."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from lerobot.envs.configs import EnvConfig

from lerobot_act_chunking.diagnostics.core.rollouts import roll_out
from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate
from lerobot_act_chunking.diagnostics.core.success_keys import check_said
from lerobot_act_chunking.diagnostics.steps.grid import Cell
from lerobot_act_chunking.policies.loading import load_policy

MOST_STEPS = 20


@dataclass(frozen=True)
class SuccessOfCell:
    """Success with one sampler and number of steps."""

    cell: Cell
    rate: SuccessRate

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, with the 95 % Wilson interval."""
        return {**asdict(self.cell), **asdict(self.rate), "interval": list(self.rate.interval)}


def success_by_steps(
    checkpoint: str,
    cells: Sequence[Cell],
    env_config: EnvConfig,
    *,
    seeds: Sequence[int],
    progress: Callable[[int, int], None] | None = None,
) -> list[SuccessOfCell]:
    """Run the same episodes with each sampler and step count.

    Args:
        checkpoint: a `diffusion_chunked` checkpoint.
        cells: what to sample with.
        env_config: of the environment to run.
        seeds: one per episode.
        progress: called with the numbers of episodes finished and planned.

    Raises:
        ConfigurationError: the environment says nothing of success.
    """
    policy = load_policy(checkpoint)
    config = policy.policy.config
    found = []
    for done, cell in enumerate(cells):
        config.sampler, config.num_inference_steps = cell.sampler, cell.n_steps
        config.timestep_spacing = cell.spacing

        def show(finished: int, before: int = done * len(seeds)) -> None:
            if progress is not None:
                progress(before + finished, len(cells) * len(seeds))

        rollouts = roll_out(policy, env_config, seeds, log_chunks=False, progress=show)
        check_said(env_config, [rollout.instead for rollout in rollouts])
        successes = sum(rollout.success for rollout in rollouts)
        found.append(SuccessOfCell(cell, SuccessRate(successes, len(seeds))))
    return found


def cells_to_run(own: Cell, cells: Sequence[Cell]) -> list[Cell]:
    """The policy's own sampler with few steps, where success may depend on them."""
    same_sampler = [cell for cell in cells if (cell.sampler, cell.spacing) == (own.sampler, own.spacing)]
    return [cell for cell in same_sampler if cell.n_steps <= MOST_STEPS or cell == own]
