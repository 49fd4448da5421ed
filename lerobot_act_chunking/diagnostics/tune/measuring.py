"""Episodes of candidates, here or in worker processes."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from lerobot_act_chunking.diagnostics.core.executable import execute
from lerobot_act_chunking.diagnostics.core.rollouts import roll_out
from lerobot_act_chunking.diagnostics.core.success_keys import check_said
from lerobot_act_chunking.diagnostics.core.tasks import open_tasks
from lerobot_act_chunking.diagnostics.tune.candidates import Candidate
from lerobot_act_chunking.diagnostics.tune.racing import Cell
from lerobot_act_chunking.diagnostics.tune.subject import Subject
from lerobot_act_chunking.executors import Cluster, Executor, Places
from lerobot_act_chunking.policies.loading import LoadedPolicy

CandidateCell = Cell[Candidate]
Outcome = tuple[CandidateCell, list[bool]]


@dataclass(frozen=True)
class Episodes:
    """Which episodes are run.

    Attributes:
        subject: whose.
        env_config: where; of any LeRobot environment.
        seed: of the first.
    """

    subject: Subject
    env_config: Any
    seed: int

    def play(self, policy: LoadedPolicy, cell: CandidateCell) -> list[bool]:
        """Which of a cell's episodes succeed.

        Raises:
            ConfigurationError: the environment says nothing of success.
        """
        execute(policy, cell.candidate.values)
        first = self.seed + cell.start
        rollouts = roll_out(policy, self.env_config, range(first, first + cell.n), log_chunks=False)
        check_said(self.env_config, [rollout.instead for rollout in rollouts])
        return [rollout.success for rollout in rollouts]


def make_runner(
    episodes: Episodes, workers: int, policy: LoadedPolicy, cluster: Cluster | None = None
) -> Executor[CandidateCell, list[bool]]:
    """One worker runs here with the policy that is loaded, more load it in processes of their own."""
    alone = workers == 1 and cluster is None
    player = partial(_player, episodes, policy if alone else None)
    return open_tasks(player, workers, cluster, [episodes.subject.checkpoint])


@contextmanager
def _player(
    episodes: Episodes, policy: LoadedPolicy | None, places: Places
) -> Iterator[Callable[[CandidateCell], list[bool]]]:
    """Runs a cell with the policy that is loaded, or one of this process's own."""
    if policy is None:
        with places(episodes.subject.checkpoint) as folder:
            policy = replace(episodes.subject, checkpoint=folder).load()
    yield partial(episodes.play, policy)
