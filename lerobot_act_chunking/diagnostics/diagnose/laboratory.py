"""Runs episodes that are missing, and keeps all of them."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from lerobot_act_chunking.diagnostics.core.clock import Clock
from lerobot_act_chunking.diagnostics.core.outcomes import Outcomes
from lerobot_act_chunking.diagnostics.core.rollouts import Rollout
from lerobot_act_chunking.diagnostics.core.tasks import open_tasks
from lerobot_act_chunking.diagnostics.diagnose.playing import Stage, Task
from lerobot_act_chunking.diagnostics.diagnose.records import Record, keep, make_record, read_kept
from lerobot_act_chunking.diagnostics.diagnose.trials import AS_IT_IS, Trial
from lerobot_act_chunking.executors import Executor, each_done

Plan = Mapping[Trial, Sequence[int]]
Found = dict[Trial, dict[int, bool]]


class Laboratory:
    """Episodes of one policy with one thing changed at a time.

    Args:
        tasks: runs them.
        store: keeps their outcomes.
        clock: whether there is time for more.
        batch_size: episodes that act together.
        names: of the action's dimensions.
    """

    def __init__(
        self,
        tasks: Executor[Task, list[Rollout]],
        store: Outcomes,
        clock: Clock,
        batch_size: int,
        names: Sequence[str],
    ) -> None:
        self._tasks, self._store, self._clock = tasks, store, clock
        self._batch_size, self._names = batch_size, names
        self.complete = True

    def record(self, seeds: Sequence[int]) -> list[Record]:
        """The policy as it is, with everything written down; fewer episodes where time ends."""
        groups = {task.key: (task, number) for number, task in enumerate(self._split(AS_IT_IS, seeds, {}))}
        found: dict[int, list[Record]] = {}
        self._clock.advance(planned=len(seeds))
        missing = []
        for task, number in groups.values():
            kept = read_kept(self._path(number)) if self._store.get(task.key) is not None else None
            if kept is None:
                missing.append(task)
            else:
                found[number] = kept
                self._clock.advance(done=len(kept))
        for task, rollouts in self._run(missing):
            _, number = groups[task.key]
            found[number] = [make_record(each, self._names) for each in rollouts]
            keep(found[number], self._path(number))
            self._store.put(task.key, [each.success for each in rollouts])
        return [record for number in sorted(found) for record in found[number]]

    def try_out(self, plan: Plan, given: Mapping[int, np.ndarray] | None = None) -> Found:
        """Which of these episodes succeed with what each trial changes; fewer where time ends.

        Args:
            plan: seeds for each trial.
            given: commands (t, A) by which episodes begin, by their seeds.
        """
        given = given or {}
        tasks = [task for trial, seeds in plan.items() for task in self._split(trial, seeds, given)]
        self._clock.advance(planned=sum(len(task.seeds) for task in tasks))
        found: Found = {trial: {} for trial in plan}
        missing = []
        for task in tasks:
            kept = self._store.get(task.key)
            if kept is None:
                missing.append(task)
            else:
                found[task.trial].update(zip(task.seeds, kept, strict=True))
                self._clock.advance(done=len(kept))
        for task, rollouts in self._run(missing):
            successes = [each.success for each in rollouts]
            self._store.put(task.key, successes)
            found[task.trial].update(zip(task.seeds, successes, strict=True))
        return found

    def _run(self, missing: Sequence[Task]) -> Iterator[tuple[Task, list[Rollout]]]:
        done = 0
        for task, rollouts in each_done(self._tasks, missing, self._clock.may_begin) if missing else ():
            done += 1
            self._clock.advance(done=len(rollouts))
            yield task, rollouts
        self.complete &= done == len(missing)

    def _split(self, trial: Trial, seeds: Sequence[int], given: Mapping[int, np.ndarray]) -> list[Task]:
        groups = [
            tuple(seeds[first : first + self._batch_size]) for first in range(0, len(seeds), self._batch_size)
        ]
        return [
            Task(trial, group, {seed: given[seed] for seed in group if seed in given}) for group in groups
        ]

    def _path(self, number: int) -> Path:
        return self._store.folder / "as_it_is" / f"{number:05d}"


@contextmanager
def open_laboratory(
    stage: Stage, store: Outcomes, clock: Clock, *, batch_size: int, workers: int, names: Sequence[str]
) -> Iterator[Laboratory]:
    """One worker runs episodes here, more in processes of their own."""
    with open_tasks(stage.open, workers) as tasks:
        yield Laboratory(tasks, store, clock, batch_size, names)
