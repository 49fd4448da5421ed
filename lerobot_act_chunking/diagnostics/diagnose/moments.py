"""When an episode is lost: the last state from which some intervention still saves it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from lerobot.envs.configs import EnvConfig

from lerobot_act_chunking.diagnostics.core.worlds import open_worlds
from lerobot_act_chunking.diagnostics.diagnose.laboratory import Found, Laboratory
from lerobot_act_chunking.diagnostics.diagnose.records import Record
from lerobot_act_chunking.diagnostics.diagnose.trials import Trial

ROUNDS = 3
"""Halvings of the time within which an episode is lost."""
SAME = 1e-6
"""Difference of two rewards that is rounding."""


@dataclass(frozen=True)
class Moments:
    """The last states that were still good.

    Attributes:
        good: by seed, the last step known from which an intervention saves the episode.
        lost: the first step known from which none does; its end where all do.
        found: which episodes each intervention saves from there.
    """

    good: Mapping[int, int] = field(default_factory=dict)
    lost: Mapping[int, int] = field(default_factory=dict)
    found: Found = field(default_factory=dict)


def repeats_itself(env_config: EnvConfig, policy_config: Any, records: Sequence[Record]) -> bool:
    """Whether the same commands from the same seed bring the same rewards, to the last step.

    Args:
        env_config: of the environment.
        policy_config: of the policy that acted.
        records: episodes to try it with.
    """
    worlds = open_worlds(env_config, 1, policy_config)
    try:
        (env,) = worlds.envs
        return all(_repeats(env, worlds.reset_options, record) for record in records)
    finally:
        worlds.close()


def _repeats(env: Any, reset_options: Any, record: Record) -> bool:
    env.reset(seed=record.episode.seed, options=reset_options)
    for step, command in enumerate(record.commands):
        observation, reward, *_ = env.step(command)
        if abs(reward - record.rewards[step]) > SAME:
            return False
        state = np.ravel(observation.get("agent_pos", ()))
        if step + 1 < len(record.states) and not np.array_equal(state, record.states[step + 1]):
            return False
    return True


def find_moments(
    laboratory: Laboratory, trials: Sequence[Trial], records: Mapping[int, Record], saved: Sequence[int]
) -> Moments:
    """Halve the time within which each episode is lost, and see what each intervention does there.

    The episode's own commands lead to a step, then a trial takes over. It has been saved from the start by
    one of them.

    Args:
        laboratory: runs the episodes.
        trials: that take over.
        records: the failing episodes, by their seeds.
        saved: seeds of those that a trial has saved from the start.
    """
    good = dict.fromkeys(saved, 0)
    lost = {seed: len(records[seed].commands) for seed in saved}
    best: dict[int, dict[Trial, bool]] = {}
    for halving in range(ROUNDS):
        ends = {seed: records[seed].progress_ended for seed in saved}
        steps = {
            seed: (good[seed] + lost[seed]) // 2
            if halving or ends[seed] >= lost[seed] - 1
            else max(1, ends[seed])
            for seed in saved
        }
        steps = {seed: step for seed, step in steps.items() if good[seed] < step < lost[seed]}
        if not steps:
            break
        given = {seed: records[seed].commands[:step] for seed, step in steps.items()}
        found = laboratory.try_out({trial: list(steps) for trial in trials}, given)
        for seed, step in steps.items():
            outcomes = {trial: found[trial][seed] for trial in trials if seed in found[trial]}
            if len(outcomes) < len(trials):
                continue
            if any(outcomes.values()):
                good[seed], best[seed] = step, outcomes
            else:
                lost[seed] = step
    return Moments(good, lost, _by_trial(trials, best))


def _by_trial(trials: Sequence[Trial], best: Mapping[int, Mapping[Trial, bool]]) -> Found:
    return {trial: {seed: outcomes[trial] for seed, outcomes in best.items()} for trial in trials}
