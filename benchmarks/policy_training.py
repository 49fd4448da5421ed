"""Training a policy as a user does, once."""

import json
import math
import os
import resource
import shutil
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from rich.console import Console

from lerobot_act_chunking.cli.quickstart import QuickstartPlan, run
from lerobot_act_chunking.compat import trackers_off
from lerobot_act_chunking.envs.robotics.tasks import TASKS as ROBOTICS_TASKS

READER = "ACT_CHUNKING_FAST_CHUNKS"


@dataclass(frozen=True)
class Variant:
    """A policy's settings.

    Attributes:
        policy: settings of lerobot-train.
        steps: training steps.
        batch_size: of them.
        before: a command to run first; its ``{dataset}`` and ``{folder}``, like those of ``policy``, are the
            recording's and the training's.
        fast_reader: also LeRobot's own policies learn through this package's dataset reader.
        velocity: observe velocities, too.
    """

    policy: dict[str, Any]
    steps: int
    batch_size: int
    before: tuple[str, ...] = ()
    fast_reader: bool = False
    velocity: bool = False

    @property
    def is_lerobot(self) -> bool:
        """LeRobot's own policy, which also keeps LeRobot's own dataset reader unless told otherwise."""
        return not self.policy["type"].endswith("_chunked")

    @property
    def reader(self) -> str:
        """What the environment variable says about the dataset reader."""
        return "1" if self.fast_reader or not self.is_lerobot else "0"


def usual_episodes(task: str) -> int:
    """Demonstrations of a task unless another number is asked for."""
    return 100 if task in ROBOTICS_TASKS else 50


@dataclass(frozen=True)
class Recording:
    """Demonstrations of a task, made where they are missing.

    Attributes:
        folder: of all tasks.
        task: which.
        velocity: observe velocities, too.
        operators: who demonstrates; the expert as it is if nobody.
        episodes: how many demonstrations; by default 50 of ALOHA's tasks and 100 of others.
    """

    folder: Path
    task: str
    velocity: bool = False
    operators: tuple[str, ...] = ()
    episodes: int | None = None

    @property
    def dataset(self) -> Path:
        return self.folder / self.task / ("dataset_velocity" if self.velocity else "dataset")

    @property
    def repo_id(self) -> str:
        return f"local/{self.task}"

    def record(self, console: Console) -> None:
        if not (self.dataset / "meta" / "info.json").exists():
            run(self.command(), console)

    def command(self) -> list[str]:
        """What a user would type."""
        env = "gymnasium_robotics" if self.task in ROBOTICS_TASKS else "aloha_sim"
        episodes = self.episodes or usual_episodes(self.task)
        return [
            *("act-chunking", "record", "--env", env, "--task", self.task, "--episodes", str(episodes)),
            *("--repo-id", self.repo_id, "--root", str(self.dataset), "--workers", "2"),
            "--velocity" if self.velocity else "--no-velocity",
            *(("--operators", ",".join(self.operators)) if self.operators else ()),
        ]


@dataclass(frozen=True)
class Training:
    """One policy: its folder, and how it came about."""

    folder: Path
    variant: Variant
    seed: int
    recording: Recording | QuickstartPlan

    @property
    def checkpoints(self) -> Path:
        return self.folder / "train" / "checkpoints"

    @cached_property
    def facts(self) -> dict[str, Any]:
        """Steps, minutes and parameters, once trained."""
        return json.loads((self.folder / "training.json").read_text())

    def commands(self) -> Iterator[list[str]]:
        """What a user would type."""
        variant, data = self.variant, self.recording
        places = {"{dataset}": str(data.dataset), "{folder}": str(self.folder)}
        if variant.before:
            yield [_put(word, places) for word in variant.before]
        yield [
            "lerobot-train",
            *(f"--policy.{name}={_put(str(value), places)}" for name, value in variant.policy.items()),
            *(f"--dataset.repo_id={data.repo_id}", f"--dataset.root={data.dataset}"),
            *(f"--output_dir={self.folder / 'train'}", f"--seed={self.seed}"),
            *(f"--steps={variant.steps}", f"--save_freq={max(1, variant.steps // 5)}"),
            *(f"--log_freq={max(1, variant.steps // 20)}", f"--batch_size={variant.batch_size}"),
            *("--num_workers=0", "--env_eval_freq=0"),
            *trackers_off(),
        ]

    def train(self, console: Console) -> None:
        """Train, unless that was done before; what was interrupted begins again."""
        if (self.folder / "training.json").exists():
            return
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        os.environ[READER] = self.variant.reader
        started, cpu = time.monotonic(), _children_seconds()
        for command in self.commands():
            run(command, console)
        facts = {
            "steps": self.variant.steps,
            "minutes": (time.monotonic() - started) / 60,
            "cpu_minutes": (_children_seconds() - cpu) / 60,
            "parameters": _parameters(self.checkpoints / "last"),
        }
        (self.folder / "training.json").write_text(json.dumps(facts, indent=2) + "\n")


def _put(word: str, places: Mapping[str, str]) -> str:
    for name, value in places.items():
        word = word.replace(name, value)
    return word


def _children_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _parameters(checkpoint: Path) -> int:
    """Numbers that the trained network consists of."""
    from safetensors import safe_open

    with safe_open(checkpoint / "pretrained_model" / "model.safetensors", "pt") as weights:
        names = [name for name in weights.keys() if not name.startswith("training_noise")]  # noqa: SIM118
        return sum(math.prod(weights.get_slice(name).get_shape()) for name in names)
