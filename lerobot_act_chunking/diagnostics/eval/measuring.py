"""Runs what is missing, and hands out what is there."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field

from lerobot_act_chunking.diagnostics.core.played import Episode
from lerobot_act_chunking.diagnostics.core.tasks import open_tasks
from lerobot_act_chunking.diagnostics.eval.deciding import Decision, decide
from lerobot_act_chunking.diagnostics.eval.episodes import Group
from lerobot_act_chunking.diagnostics.eval.playing import Played, Stage, Task
from lerobot_act_chunking.diagnostics.eval.runs import Run
from lerobot_act_chunking.executors import Cluster, Executor, each_done


@dataclass
class Results:
    """Finished groups of all runs.

    Attributes:
        episodes: how many of each are asked for.
        groups: of each run, by its title, in the order of their numbers.
    """

    episodes: int
    groups: dict[str, dict[int, Group]] = field(default_factory=dict)

    def of(self, run: Run) -> list[Episode]:
        """The episodes of a run, in the order of their seeds."""
        found = self.groups.get(run.title, {})
        return [each for number in sorted(found) for each in found[number].episodes][: self.episodes]

    @property
    def is_judged(self) -> bool:
        """Whether any episode was ever called a success or none."""
        groups = [each for found in self.groups.values() for each in found.values()]
        return any(one.instead is None for each in groups for one in each.episodes)

    def successes(self, run: Run) -> list[bool]:
        """Which of them succeeded."""
        return [each.success for each in self.of(run)]


def measure(
    runs: Sequence[Run],
    stage: Stage,
    numbers: Sequence[int],
    *,
    episodes: int,
    workers: int,
    cluster: Cluster | None = None,
    until_decided: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Results, Decision | None]:
    """The episodes of all runs; those that are not on the disk are run, and written down at once.

    Args:
        runs: the checkpoints.
        stage: where they act.
        numbers: of the groups that are wanted of each.
        episodes: most of each run that count.
        workers: processes.
        cluster: whose; by default this machine's.
        until_decided: end after the first group with which it is known which is best, or with which nothing
            is known of success.
        progress: called with the numbers of episodes done and planned.
    """
    results = Results(episodes, {run.title: dict(run.groups(numbers)) for run in runs})
    planned = len(runs) * len(numbers)
    decision = None
    rounds = [[number] for number in numbers] if until_decided else [list(numbers)]
    with ExitStack() as resources:
        tasks: Executor[Task, Played] | None = None
        for wanted in rounds:
            missing = {
                run.task(number): (run, number)
                for number in wanted
                for run in runs
                if number not in results.groups[run.title]
            }
            if missing and tasks is None:
                tasks = resources.enter_context(
                    open_tasks(stage.open, min(workers, planned), cluster, stage.subjects)
                )
            for task, played in each_done(tasks, missing) if tasks is not None else ():
                run, number = missing[task]
                run.keep(number, played)
                results.groups[run.title][number] = played.group
                if progress is not None:
                    done = sum(map(len, results.groups.values()))
                    progress(done * stage.batch_size, planned * stage.batch_size)
            if until_decided:
                decision = decide({run.title: results.successes(run) for run in runs}, episodes)
                if decision.decided or not results.is_judged:
                    break
    return results, decision
