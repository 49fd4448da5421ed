"""Lets a checkpoint act in one group of episodes."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

import numpy as np

from lerobot_act_chunking.data.dimension_names import is_hand
from lerobot_act_chunking.diagnostics.core.played import describe
from lerobot_act_chunking.diagnostics.core.rollouts import roll_out
from lerobot_act_chunking.diagnostics.eval.episodes import Group, timing_of
from lerobot_act_chunking.diagnostics.eval.subject import Subject
from lerobot_act_chunking.executors import Places
from lerobot_act_chunking.policies.loading import LoadedPolicy, load_policy


@dataclass(frozen=True)
class Task:
    """A group of episodes of one checkpoint.

    Attributes:
        checkpoint: folder or repo id.
        draw: which of several repetitions, each with other noise.
        number: of the group, from 0 on.
    """

    checkpoint: str
    draw: int
    number: int


@dataclass(frozen=True)
class Played:
    """A group as it came out.

    Attributes:
        group: what is written down.
        motion: of each episode the commands ``(T, A)`` and the states ``(T, S)``, as ``commands_3`` and
            ``states_3`` of the fourth.
    """

    group: Group
    motion: dict[str, np.ndarray]


@dataclass(frozen=True)
class Stage:
    """Where checkpoints act.

    Attributes:
        subjects: the checkpoints, by their folders or repo ids.
        seed: of the first episode.
        batch_size: episodes in a group.
    """

    subjects: dict[str, Subject]
    seed: int
    batch_size: int

    @contextmanager
    def open(self, places: Places) -> Iterator[Callable[[Task], Played]]:
        """What plays tasks; it keeps the checkpoint that it has loaded last."""
        yield partial(self._play, _Shelf(places))

    def _play(self, shelf: "_Shelf", task: Task) -> Played:
        policy = shelf.policy(task.checkpoint)
        subject = self.subjects[task.checkpoint]
        first = self.seed + task.number * self.batch_size
        seeds = range(first, first + self.batch_size)
        started = time.perf_counter()
        rollouts = roll_out(
            policy, subject.env_config, seeds, n_envs=self.batch_size, log_chunks=False, draw=task.draw
        )
        names = subject.action_names
        arms = [dim for dim, name in enumerate(names) if not is_hand(name)] or list(range(len(names)))
        timing = timing_of(rollouts, time.perf_counter() - started)
        motion = {
            f"{kind}_{place}": values.astype(np.float32)
            for place, rollout in enumerate(rollouts)
            for kind, values in (("commands", rollout.commands), ("states", rollout.states))
        }
        return Played(Group(tuple(describe(each, arms) for each in rollouts), timing), motion)


class _Shelf:
    """The checkpoint that was loaded last."""

    def __init__(self, places: Places) -> None:
        self._places = places
        self._checkpoint: str | None = None

    def policy(self, checkpoint: str) -> LoadedPolicy:
        if checkpoint != self._checkpoint:
            with self._places(checkpoint) as folder:
                self._policy = load_policy(folder)
            self._checkpoint = checkpoint
        return self._policy
