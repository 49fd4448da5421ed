"""Episodes of the policy with their chunks, in groups that act together."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from lerobot.envs.configs import EnvConfig

from lerobot_act_chunking.diagnostics.core.clock import Progress
from lerobot_act_chunking.diagnostics.core.rollouts import Rollout, roll_out
from lerobot_act_chunking.diagnostics.core.tasks import open_tasks
from lerobot_act_chunking.diagnostics.modes.settings import Settings
from lerobot_act_chunking.executors import Places, each_done
from lerobot_act_chunking.policies.loading import load_policy


@dataclass(frozen=True)
class Stage:
    """Where the policy acts.

    Attributes:
        checkpoint: folder or repo id.
        env_config: of the environment that shows what it observes.
    """

    checkpoint: str
    env_config: EnvConfig

    @contextmanager
    def open(self, places: Places) -> Iterator[Callable[[range], list[Rollout]]]:
        """What plays the episodes of some seeds together."""
        with places(self.checkpoint) as folder:
            policy = load_policy(folder)
        yield lambda seeds: roll_out(policy, self.env_config, seeds, n_envs=len(seeds))


def play(settings: Settings, env_config: EnvConfig, progress: Progress | None) -> list[Rollout]:
    """All episodes, in the order of their seeds.

    Args:
        settings: what is asked.
        env_config: of the environment.
        progress: called with the numbers of episodes done and planned.
    """
    seeds = range(settings.seed, settings.seed + settings.episodes)
    groups = [seeds[at : at + settings.batch_size] for at in range(0, len(seeds), settings.batch_size)]
    stage, found = Stage(settings.checkpoint, env_config), dict[range, list[Rollout]]()
    workers = min(settings.workers, len(groups))
    with open_tasks(stage.open, workers, settings.cluster, [settings.checkpoint]) as tasks:
        for group, rollouts in each_done(tasks, groups):
            found[group] = rollouts
            if progress is not None:
                progress(sum(map(len, found)), settings.episodes)
    return [rollout for group in groups for rollout in found[group]]
