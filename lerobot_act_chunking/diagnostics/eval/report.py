"""Everything the evaluation found, as one object: the command prints it, JSON holds it, plots draw it."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from statistics import fmean, median
from typing import Any, ClassVar

import numpy as np

from lerobot_act_chunking.diagnostics.core.eval_info import EVAL_INFO
from lerobot_act_chunking.diagnostics.core.played import Episode
from lerobot_act_chunking.diagnostics.core.recipes import Recipe
from lerobot_act_chunking.diagnostics.core.report import Report
from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate
from lerobot_act_chunking.diagnostics.eval.deciding import LEVEL, Decision
from lerobot_act_chunking.diagnostics.eval.episodes import Group
from lerobot_act_chunking.diagnostics.eval.films import Film
from lerobot_act_chunking.diagnostics.eval.runs import Run
from lerobot_act_chunking.diagnostics.eval.settings import Settings


@dataclass(frozen=True)
class RunResult:
    """What one checkpoint did.

    Attributes:
        run: the checkpoint, and the draw of its noise.
        episodes: in the order of their seeds.
        groups: the finished groups, by their numbers.
        dt: control period [s].
        action_names: of the A numbers of a command.
        dataset: of the training: its folder, and its SHA-256 if it is here; None where it is not known.
        films: of some of the episodes.
        is_judged: whether the environment ever said of any policy whether an episode succeeds; if not,
            successes and failures mean nothing.
    """

    run: Run
    episodes: Sequence[Episode]
    groups: Mapping[int, Group]
    dt: float
    action_names: Sequence[str]
    dataset: dict[str, str | None] | None = None
    films: Sequence[Film] = ()
    is_judged: bool = True

    @cached_property
    def rate(self) -> SuccessRate:
        """Of all episodes."""
        return SuccessRate(sum(each.success for each in self.episodes), len(self.episodes))

    def commands(self, place: int) -> np.ndarray:
        """The commands (T, A) of the episode at this place."""
        group, within = divmod(place, int(self.run.question["batch_size"]))
        return self.run.motion(sorted(self.groups)[group], within, "commands")

    @property
    def rules(self) -> dict[str, int]:
        """Episodes whose last step satisfied each of the environment's rules, beside ``is_success``."""
        names = dict.fromkeys(name for each in self.episodes for name in each.rules)
        return {
            name: sum(each.rules.get(name, False) for each in self.episodes)
            for name in names
            if name != "is_success"
        }

    @property
    def failures(self) -> dict[str, int]:
        """Failed episodes by their labels, the most frequent first; none where that is not known."""
        labels = [each.label for each in self.episodes if each.label is not None and self.is_judged]
        return dict(Counter(labels).most_common())

    @property
    def stalled(self) -> int:
        """Failed episodes at whose end nothing moved."""
        return sum(each.stalled for each in self.episodes)

    @property
    def sum_reward(self) -> float:
        """Mean over the episodes of the sum of their rewards."""
        return fmean(each.sum_reward for each in self.episodes)

    @property
    def seconds(self) -> float:
        """Median length of an episode [s]."""
        return self.dt * median(each.length for each in self.episodes)

    @property
    def seconds_to_success(self) -> float | None:
        """Median length of the successful ones [s]."""
        lengths = [each.length for each in self.episodes if each.success]
        return self.dt * median(lengths) if lengths else None

    @property
    def network_calls(self) -> float:
        """Per second of motion."""
        calls = sum(each.network_calls for each in self.episodes)
        return calls / (self.dt * sum(each.length for each in self.episodes))

    def median_of(self, name: str) -> float | None:
        """Of a measure of smoothness over the episodes that define it."""
        values = [value for each in self.episodes if (value := getattr(each, name)) is not None]
        return median(values) if values else None

    def milliseconds(self, name: str) -> float | None:
        """Median time of a control step [ms], for a whole group of episodes."""
        values = [
            value
            for each in (group.timing for group in self.groups.values())
            if (value := getattr(each, name)) is not None
        ]
        return median(values) if values else None

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dictionaries."""
        known = self.is_judged
        return {
            "title": self.run.title,
            "recipe": self.run.name,
            "training": self.run.training,
            "draw": self.run.draw,
            "checkpoint": self.run.checkpoint,
            "policy_type": self.run.policy_type,
            "dataset": self.dataset,
            "successes": self.rate.successes if known else None,
            "episodes": self.rate.episodes,
            "interval": list(self.rate.exact_interval) if known else None,
            "is_judged": known,
            "rules": self.rules,
            "failures": self.failures,
            "stalled": self.stalled if known else None,
            "mean_sum_reward": self.sum_reward,
            "median_seconds": self.seconds,
            "median_seconds_to_success": self.seconds_to_success,
            "network_calls_per_second": self.network_calls,
            "network_step_ms": self.milliseconds("network_ms"),
            "other_step_ms": self.milliseconds("other_ms"),
            "log_dimensionless_jerk": self.median_of("log_dimensionless_jerk"),
            "sparc": self.median_of("sparc"),
            "failed_seeds": [each.seed for each in self.episodes if known and not each.success],
            "question": self.run.question,
        }


@dataclass(frozen=True, kw_only=True)
class EvalReport(Report):
    """The answer to: how often does it succeed, and what goes wrong?

    Attributes:
        requested: what was asked.
        results: of every checkpoint and draw.
        decision: where the comparison ended, if it was to end as soon as it is decided.
        machine: what it ran on.
        folder: of all files.
        complete: whether all episodes that were asked for are there; not so for a part of them.
        notes: what to know about the figures.
    """

    tool: ClassVar[str] = "eval"
    requested: Settings
    results: Sequence[RunResult]
    decision: Decision | None
    machine: dict[str, Any]
    folder: Path
    complete: bool
    notes: list[str]

    @property
    def recipes(self) -> tuple[Recipe, ...]:
        """The policies by the ``eval_info.json`` of each training's first draw."""
        first = [each.run for each in self.results if not each.run.draw]
        names = dict.fromkeys(run.name for run in first)
        return tuple(
            Recipe(name, tuple(str(run.folder / EVAL_INFO) for run in first if run.name == name))
            for name in names
        )

    @property
    def is_judged(self) -> bool:
        """Whether anything is known of success; the environment is one for all."""
        return all(each.is_judged for each in self.results)

    @property
    def labels(self) -> list[str]:
        """Every label of a failure, the most frequent over all policies first."""
        counts = sum((Counter(each.failures) for each in self.results), Counter[str]())
        return [label for label, _ in counts.most_common()]

    def content(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dictionaries; None for what was not or cannot be measured."""
        decision = self.decision and {**asdict(self.decision), "decided": self.decision.decided}
        return {
            "verdict": self.verdict,
            "reasons": self.reasons,
            "thresholds": {"level": LEVEL},
            "environment": self.results[0].run.question["environment"],
            "episodes": self.requested.episodes,
            "seed": self.requested.seed,
            "batch_size": self.requested.batch_size,
            "complete": self.complete,
            "policies": [each.to_json() for each in self.results],
            "decision": decision,
            "machine": self.machine,
            "folder": str(self.folder),
            "notes": self.notes,
        }
