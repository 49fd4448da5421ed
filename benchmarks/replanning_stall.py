"""Why policies stall when they replan often: the experiments of docs/studies/execution-study.md.

    python benchmarks/replanning_stall.py [--episodes 200]

Four questions, each an experiment on the same seeds, without ensembling:

1. pauses: policies trained on demonstrations that pause for 0, 0.2, 0.5 or 1 s at each grasp and release.
2. training: one policy's checkpoints, replanning at every step.
3. where: the demonstrated frames nearest to a stalled state. If two phases of the task look alike, these come
   from both.
4. plan: how far the stalled policy's own chunk moves. And the intervention: the same policy, replanning at
   every step just the same, but carrying out the chunk's j-th action in place of its first.

Trains what is not there yet; every evaluation is written down when it is done.
"""

import argparse
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from execution_study import CHECKPOINTS, FIRST_SEED, configure, prepare
from rich.console import Console
from rich.table import Table

from lerobot_act_chunking.cli.quickstart import QuickstartPlan
from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate
from lerobot_act_chunking.durable_files import write_atomically
from lerobot_act_chunking.envs.aloha.tasks import TASKS

PAUSES = (1.0, 0.5, 0.2)
INTERVALS = (1, 5, 10, 25, 50)
LOOKAHEADS = (1, 2, 5, 10)
ARMS = [*range(6), *range(7, 13)]
STILL = 1e-3  # [rad per step], largest change of any arm joint's command
STILL_STEPS = 50
NEIGHBOURS = 50


@dataclass(frozen=True)
class PausedPlan(QuickstartPlan):
    """The quickstart, with a demonstrator that pauses."""

    dwell: float = 0.0

    def record_command(self) -> list[str]:
        return [*super().record_command(), "--dwell", str(self.dwell)]


@dataclass(frozen=True)
class Stall:
    """A stalled policy's last moment, as medians over the stalled episodes.

    Attributes:
        episodes: stalled episodes.
        frames: first, second and third quartile of the nearest demonstrated frames' steps, within an episode.
        far_share: share of neighbours more than 50 steps from an episode's median neighbour.
        plan: distance [rad] of the chunk's j-th action from the pose, over the arms, (K,).
        demonstrated: the same of the nearest demonstrated frame's next actions, (K,).
    """

    episodes: int
    frames: list[float]
    far_share: float
    plan: list[float]
    demonstrated: list[float]


@dataclass(frozen=True)
class Trial:
    """One evaluation."""

    task: str
    pause_s: float
    training_steps: int
    replan_interval: int
    lookahead: int
    episodes: int
    failed_seeds: list[int]
    stalled: int
    stall: Stall | None = field(default=None)

    @property
    def key(self) -> str:
        return trial_key(self.task, self.pause_s, self.training_steps, self.replan_interval, self.lookahead)

    @property
    def rate(self) -> SuccessRate:
        return SuccessRate(self.episodes - len(self.failed_seeds), self.episodes)


def trial_key(task: str, pause: float, steps: int, interval: int, lookahead: int) -> str:
    return f"{task}, pauses of {pause:g} s, {steps} training steps, R={interval}, action {lookahead}"


def is_stalled(rollout: Any) -> bool:
    """Whether the episode failed with the arms' commands at rest."""
    speed = np.abs(np.diff(rollout.commands[-STILL_STEPS:, ARMS], axis=0)).max()
    return not rollout.success and speed < STILL


@contextmanager
def looking_ahead(policy: Any, steps: int) -> Iterator[None]:
    """Let every chunk begin ``steps`` steps later than it should."""
    prepare = policy._prepare

    def later(window: Any, envs: Any, n_steps: int, delay: int) -> Any:
        predict = prepare(window, envs, n_steps + steps, delay)
        return lambda: predict()[:, steps:]

    policy._prepare = later
    try:
        yield
    finally:
        del policy._prepare


def demonstrations(plan: QuickstartPlan) -> dict[str, np.ndarray]:
    """All demonstrated frames: standardised observations, actions, steps and episodes."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset = LeRobotDataset(plan.repo_id, root=plan.dataset)
    columns = ("observation.state", "observation.environment_state", "action", "frame_index", "episode_index")
    table = dataset.hf_dataset.select_columns(list(columns)).with_format("numpy")[:]
    observed = np.concatenate([table[columns[0]], table[columns[1]]], axis=1)
    return {
        "observed": observed,
        "scale": np.maximum(observed.std(0), 1e-2),
        "action": table["action"],
        "step": table["frame_index"],
        "episode": table["episode_index"],
    }


def look_at(stalled: list[Any], states: dict[int, np.ndarray], demos: dict[str, np.ndarray]) -> Stall:
    """Where the stalled episodes stand, and what their last chunks planned."""
    frames, far, plans, shown = [], [], [], []
    for rollout in stalled:
        state = np.concatenate([rollout.positions[-1], states[rollout.seed]])
        distance = np.linalg.norm((demos["observed"] - state) / demos["scale"], axis=1)
        nearest = np.argsort(distance)[:NEIGHBOURS]
        steps = demos["step"][nearest]
        frames.append(np.quantile(steps, [0.25, 0.5, 0.75]))
        far.append(np.mean(np.abs(steps - np.median(steps)) > 50))
        chunk, pose = rollout.inferences[-1].chunk, rollout.positions[-1]
        plans.append(np.linalg.norm((chunk - pose)[:, ARMS], axis=1))
        coming = np.minimum(
            nearest[0] + np.arange(len(chunk)),
            np.flatnonzero(demos["episode"] == demos["episode"][nearest[0]])[-1],
        )
        shown.append(
            np.linalg.norm((demos["action"][coming] - demos["observed"][nearest[0], :14])[:, ARMS], axis=1)
        )
    return Stall(
        episodes=len(stalled),
        frames=np.median(frames, axis=0).tolist(),
        far_share=float(np.mean(far)),
        plan=np.median(plans, axis=0).tolist(),
        demonstrated=np.median(shown, axis=0).tolist(),
    )


def demonstrator(plan: QuickstartPlan, steps: int = 180) -> dict[str, list]:
    """How the demonstrator moves: medians over the episodes, at each of the first steps.

    ``speed`` [rad per step] is that of the arms' targets, ``grippers`` their targets (0 is closed).
    """
    demos = demonstrations(plan)
    episodes = [demos["action"][demos["episode"] == episode] for episode in np.unique(demos["episode"])]
    actions = np.median([episode[: steps + 1] for episode in episodes], axis=0)
    return {
        "speed": np.linalg.norm(np.diff(actions[:, ARMS], axis=0), axis=1).tolist(),
        "grippers": actions[:steps, [6, 13]].tolist(),
    }


class Trials:
    """Finished trials, on disk as soon as they are known, and the means to make the others."""

    def __init__(self, folder: Path, episodes: int, console: Console):
        self.folder, self.episodes, self.console = folder, episodes, console
        self.path = folder / f"stall_{episodes}.json"
        self.done: dict[str, Trial] = {}
        for each in json.loads(self.path.read_text()) if self.path.exists() else []:
            stall = Stall(**each["stall"]) if each["stall"] else None
            trial = Trial(**{**each, "stall": stall})
            self.done[trial.key] = trial

    def plan(self, task: str, pause: float) -> QuickstartPlan:
        if not pause:
            return QuickstartPlan(self.folder / task, task)
        return PausedPlan(self.folder / f"{task}_pause_{pause:g}", task, dwell=pause)

    def get(self, task: str, pause: float, steps: int, interval: int, lookahead: int = 0) -> Trial:
        key = trial_key(task, pause, steps, interval, lookahead)
        if key not in self.done:
            self.done[key] = self.make(task, pause, steps, interval, lookahead)
            self.console.print(f"{key}: {self.done[key].rate}, {self.done[key].stalled} stalled")
            write_atomically(self.path, json.dumps([asdict(trial) for trial in self.done.values()]).encode())
        return self.done[key]

    def make(self, task: str, pause: float, steps: int, interval: int, lookahead: int) -> Trial:
        from lerobot_act_chunking.diagnostics.core.environments import environment_of, task_environment
        from lerobot_act_chunking.diagnostics.core.rollouts import roll_out
        from lerobot_act_chunking.policies.loading import load_policy

        plan = self.plan(task, pause)
        prepare(plan, self.console)
        loaded = load_policy(plan.train / "checkpoints" / f"{steps:06d}" / "pretrained_model")
        execution = {"execution": "receding", "replan_interval": interval, "n_action_steps": 90}
        configure(loaded.policy, execution)
        states: dict[int, np.ndarray] = {}
        with looking_ahead(loaded.policy, lookahead):
            rollouts = roll_out(
                loaded,
                environment_of(loaded.policy.config, task_environment(task, "touch")),
                range(FIRST_SEED, FIRST_SEED + self.episodes),
                n_envs=100,
                on_step=lambda seed, _, env: states.update({seed: env.unwrapped.world.environment_state()}),
            )
        stalled = [rollout for rollout in rollouts if is_stalled(rollout)]
        looks = interval == 1 and lookahead == 0 and stalled
        return Trial(
            task=task,
            pause_s=pause,
            training_steps=steps,
            replan_interval=interval,
            lookahead=lookahead,
            episodes=self.episodes,
            failed_seeds=[rollout.seed for rollout in rollouts if not rollout.success],
            stalled=len(stalled),
            stall=look_at(stalled, states, demonstrations(plan)) if looks else None,
        )


def study(trials: Trials) -> None:
    trained, early = (int(checkpoint) for checkpoint in CHECKPOINTS)
    for task in TASKS:
        for steps in range(early, trained + 1, early):
            trials.get(task, 0.0, steps, 1)
    for task, pause, steps in (
        ("transfer_cube", 0.0, early),
        ("transfer_cube", 0.5, trained),
        ("insertion", 0.0, trained),
    ):
        for lookahead in LOOKAHEADS:
            trials.get(task, pause, steps, 1, lookahead)
    for pause in PAUSES:
        for interval in INTERVALS:
            trials.get("transfer_cube", pause, trained, interval)


def show(trials: Trials) -> None:
    table = Table("task", "pauses", "training steps", "R", "action", "success", "stalled", "far neighbours")
    for trial in trials.done.values():
        table.add_row(
            *(trial.task, f"{trial.pause_s:g} s", str(trial.training_steps), str(trial.replan_interval)),
            *(str(trial.lookahead), str(trial.rate), str(trial.stalled)),
            "-" if trial.stall is None else f"{100 * trial.stall.far_share:.0f} %",
        )
    trials.console.print(table)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--folder", type=Path, default=Path("outputs/benchmarks/execution_study"))
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/replanning_stall.json"))
    args = parser.parse_args()
    trials = Trials(args.folder, args.episodes, Console(width=170))
    study(trials)
    show(trials)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    document = {
        "trials": [asdict(trial) for trial in trials.done.values()],
        "demonstrators": {task: demonstrator(trials.plan(task, 0.0)) for task in TASKS},
    }
    args.out.write_text(json.dumps(document) + "\n")


if __name__ == "__main__":
    main()
