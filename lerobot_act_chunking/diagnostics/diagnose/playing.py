"""Lets a policy act with one thing changed."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.envs.configs import EnvConfig

from lerobot_act_chunking.data.actions import read_demonstrations
from lerobot_act_chunking.diagnostics.core.executable import Executable
from lerobot_act_chunking.diagnostics.core.rollouts import Rollout, roll_out
from lerobot_act_chunking.diagnostics.core.success_keys import check_said
from lerobot_act_chunking.diagnostics.diagnose.trials import Trial
from lerobot_act_chunking.executors import Places
from lerobot_act_chunking.policies.loading import LoadedPolicy


@dataclass(frozen=True)
class Task:
    """Episodes that act together.

    Attributes:
        trial: what is changed.
        seeds: of the episodes.
        given: commands (t, A) by which some of them begin, by their seeds.
    """

    trial: Trial
    seeds: tuple[int, ...]
    given: Mapping[int, np.ndarray] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """By which the outcome is kept."""
        begun = [f"{seed}+{len(self.given[seed])}" for seed in self.seeds if seed in self.given]
        return f"{self.trial.key} episodes {','.join(map(str, self.seeds))} after {','.join(begun)}"


@dataclass(frozen=True)
class Stage:
    """Where the policy acts.

    Attributes:
        executable: the checkpoint.
        env_config: of the environment that shows what it observes.
    """

    executable: Executable
    env_config: EnvConfig

    @contextmanager
    def open(self, _: Places = nullcontext) -> Iterator[Callable[[Task], list[Rollout]]]:
        """What plays tasks on this machine; policies are loaded once for each checkpoint."""
        yield partial(self._play, {})

    def _play(self, loaded: dict[str | None, LoadedPolicy], task: Task) -> list[Rollout]:
        trial = task.trial
        if trial.checkpoint not in loaded:
            loaded[trial.checkpoint] = self._load(trial.checkpoint)
        policy = loaded[trial.checkpoint]
        with changing(policy, trial) as acting:
            rollouts = roll_out(
                acting,
                self.env_config,
                task.seeds,
                n_envs=len(task.seeds),
                log_chunks=False,
                given=task.given,
                draw=trial.draw,
            )
        check_said(self.env_config, [rollout.instead for rollout in rollouts])
        return rollouts

    def _load(self, checkpoint: str | None) -> LoadedPolicy:
        if checkpoint is None:
            return self.executable.load()
        return Executable(checkpoint, self.executable.config, self.executable.wrapped).load()


@contextmanager
def changing(policy: LoadedPolicy, trial: Trial) -> Iterator[LoadedPolicy]:
    """The policy with what a trial changes; all is as before afterwards."""
    outer = policy.policy
    inner = getattr(outer, "inner", outer)
    with ExitStack() as stack:
        for owner, values in ((outer.config, trial.values), (inner.config, trial.acting)):
            for name, value in values:
                stack.callback(setattr, owner, name, getattr(owner, name))
                setattr(owner, name, value)
        if trial.raw_weights:
            average = inner.ema
            stack.callback(setattr, inner, "ema", average)
            inner.ema = None
        yield policy if trial.statistics is None else _normalised(policy, inner.config, trial.statistics)


def _normalised(policy: LoadedPolicy, config: Any, folder: str) -> LoadedPolicy:
    """The policy with the statistics of a dataset."""
    from lerobot.policies.factory import make_pre_post_processors

    stats = read_demonstrations(Path(folder)).stats
    return LoadedPolicy(policy.policy, *make_pre_post_processors(config, dataset_stats=stats))


def later_checkpoint(checkpoint: str) -> Path | None:
    """The last checkpoint of the same ``lerobot-train``; None without a later one."""
    folder = Path(checkpoint)
    if folder.name != "pretrained_model" or folder.parent.parent.name != "checkpoints":
        return None
    own = folder.parent.resolve()
    steps = sorted(each for each in own.parent.iterdir() if each.name.isdigit() and not each.is_symlink())
    if not steps or not own.name.isdigit() or int(steps[-1].name) <= int(own.name):
        return None
    last = steps[-1] / "pretrained_model"
    return last if last.is_dir() else None
