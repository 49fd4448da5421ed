"""The same question asked of a real policy: the object is pushed; when does the command follow?"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from typing import Any, cast

import mujoco
import numpy as np

from act_chunking_runtime.number_checks import check_positive
from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.diagnostics.bandwidth.closed_form import ensemble_weights, filter_for
from lerobot_act_chunking.diagnostics.bandwidth.filter import ROUNDING, start_up_step
from lerobot_act_chunking.diagnostics.bandwidth.source import Source, read_source
from lerobot_act_chunking.diagnostics.core.environments import environment_of, task_environment
from lerobot_act_chunking.diagnostics.core.rollouts import OnStep, Rollout, roll_out
from lerobot_act_chunking.envs.aloha.tasks import JOINT_NAMES, TASKS
from lerobot_act_chunking.envs.configuration_envs import AlohaSimEnvConfig
from lerobot_act_chunking.errors import ConfigurationError, unknown_choice
from lerobot_act_chunking.policies.execution_fields import ExecutionFields
from lerobot_act_chunking.policies.loading import LoadedPolicy, load_policy, read_config

# In radians; grippers (0 to 1) would drown them.
_ARM_JOINTS = [i for i, name in enumerate(JOINT_NAMES) if not name.endswith("gripper")]
_AVERAGED_MODES = ("ensemble", "crossfade", "adaptive", "coherence")


@dataclass(frozen=True)
class PushResponse:
    """How the command of one execution answered, over all seeds.

    Curves start at the first step whose observation shows the push.

    Attributes:
        settings: the execution.
        commanded: RMS over joints and seeds of the command with push minus the command without [rad].
        demanded: the same for the newest chunk's opinion on each step.
        shares: share of the demanded difference that was commanded, by least squares.
        expected: the closed form of ``shares``; empty where there is none.
        settle_90_steps: control steps until ``shares`` has reached 90 %; None if it never does.
        expected_settle_90_steps: the closed form's.
        successes: successful episodes with the push ...
        undisturbed_successes: ... and without.
    """

    settings: ExecutionSettings
    commanded: list[float]
    demanded: list[float]
    shares: list[float]
    expected: list[float]
    settle_90_steps: int | None
    expected_settle_90_steps: int | None
    successes: int
    undisturbed_successes: int


@dataclass(frozen=True)
class PushStudy:
    """One push, answered under several executions of one checkpoint."""

    task: str
    push_m: float
    push_step: int
    seeds: list[int]
    fps: float
    responses: list[PushResponse]

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dictionaries."""
        return asdict(self)


def study_push(
    source: Source,
    *,
    task: str,
    push_m: float,
    push_step: int,
    episodes: int,
    seed: int,
    progress: Callable[[int, int], None] | None = None,
) -> PushStudy:
    """Run the checkpoint with and without a push, as it is, without averaging, and as ``source`` asks.

    Args:
        source: a checkpoint and the execution asked for. If that averages nothing, ACT's ensemble stands for
            the one with averaging.
        task: ``transfer_cube`` or ``insertion``; there the peg is pushed.
        push_m: length of the push along x, towards the right arm [m].
        push_step: control step during which the object jumps.
        episodes: how many, each with and without the push.
        seed: of the first one.
        progress: called with the numbers of episodes finished and planned.

    Raises:
        ConfigurationError: no checkpoint, or a push outside the episode.
        FeatureError: a policy for another robot or control rate.
    """
    if source.checkpoint is None:
        raise ConfigurationError("a push needs a policy to answer it: give a checkpoint before --env")
    check_positive(episodes=episodes)
    if task not in TASKS:
        raise unknown_choice("task to push in", task, TASKS)
    own = read_source(source.checkpoint, {}).settings
    policy = load_for_execution(source.checkpoint)
    asked = task_environment(task, "touch")
    env_config = cast(AlohaSimEnvConfig, environment_of(policy.policy.config, asked, source.checkpoint))
    if not 0 <= push_step < env_config.episode_length - 1:
        raise ConfigurationError(
            f"push_step={push_step} is outside the episode: 0 to {env_config.episode_length - 2}"
        )
    seeds = list(range(seed, seed + episodes))
    responses = []
    requested = executions(own, source.settings)
    for done, settings in enumerate(requested):
        apply_execution(policy, settings)

        def show(finished: int, before: int) -> None:
            if progress is not None:
                progress(before + finished, 2 * len(requested) * len(seeds))

        before = 2 * done * len(seeds)
        quiet = roll_out(policy, env_config, seeds, progress=partial(show, before=before))
        pushed = roll_out(
            policy,
            env_config,
            seeds,
            on_step=push_object(push_step, push_m),
            progress=partial(show, before=before + len(seeds)),
        )
        responses.append(compare(settings, quiet, pushed, push_step + 1))
    return PushStudy(task, push_m, push_step, seeds, float(env_config.fps), responses)


def executions(own: ExecutionSettings, requested: ExecutionSettings) -> list[ExecutionSettings]:
    """The checkpoint's own execution, the newest chunk alone, and one that averages; without repetitions."""
    averaging = requested
    if requested.execution not in _AVERAGED_MODES:
        averaging = ExecutionSettings(requested.chunk_size, "ensemble", requested.n_action_steps)
    newest = ExecutionSettings(
        averaging.chunk_size,
        "receding",
        averaging.n_action_steps,
        averaging.replan_interval,
        averaging.latency_steps,
        smoothing_steps=averaging.smoothing_steps,
        gripper_dims=averaging.gripper_dims,
    )
    return list(dict.fromkeys((own, newest, requested, averaging)))


def load_for_execution(checkpoint: str) -> LoadedPolicy:
    """A checkpoint of any type as a policy whose execution can be changed; LeRobot's own are wrapped."""
    if isinstance(read_config(checkpoint), ExecutionFields):
        return load_policy(checkpoint)
    from lerobot_act_chunking.policies.temporal_ensemble.wrapping import load_wrapped

    return load_wrapped(checkpoint)


def apply_execution(policy: LoadedPolicy, settings: ExecutionSettings) -> None:
    """Execute the policy's chunks as ``settings`` say, from its next reset on."""
    config = policy.policy.config
    for field in fields(ExecutionFields):
        setattr(config, field.name, getattr(settings, field.name))
    config.gripper_dims = list(settings.gripper_dims)
    config.n_action_steps = settings.n_action_steps
    longest = config.execution_settings.chunk_size
    if replace(settings, chunk_size=longest) != config.execution_settings:
        raise ConfigurationError(
            f"{settings} is not what the policy would execute: {config.execution_settings}"
        )


def push_object(step: int, distance: float) -> OnStep:
    """Shift the first object along x [m] during control step ``step``; the next observation shows it."""

    def push(_seed: int, at: int, env: Any) -> None:
        if at == step:
            world = env.unwrapped.world
            objects = world.model.nq - len(world.environment_state())
            world.data.qpos[objects] += distance
            mujoco.mj_step1(world.model, world.data)  # pyright: ignore[reportAttributeAccessIssue]

    return push


def compare(
    settings: ExecutionSettings, quiet: Sequence[Rollout], pushed: Sequence[Rollout], event: int
) -> PushResponse:
    """What the push changed in the commands, beside what it changed in the newest chunks.

    Args:
        settings: the execution of all rollouts.
        quiet: episodes without the push ...
        pushed: ... and with it, of the same seeds.
        event: first control step whose observation shows the push.
    """
    length = settings.n_action_steps + settings.replan_interval
    pairs = [_differences(a, b, event, length) for a, b in zip(quiet, pushed, strict=True)]
    commanded, demanded = (np.stack(parts) for parts in zip(*pairs, strict=True))  # (N, length, joints)
    shown = ~np.isnan(commanded).all((0, 2))
    commanded, demanded = commanded[:, shown], demanded[:, shown]
    power = np.nansum(demanded**2, (0, 2))
    shares = np.nansum(commanded * demanded, (0, 2)) / np.where(power > 0, power, 1.0)
    expected = _expected(settings, event, len(shares))
    return PushResponse(
        settings=settings,
        commanded=np.sqrt(np.nanmean(commanded**2, (0, 2))).tolist(),
        demanded=np.sqrt(np.nanmean(demanded**2, (0, 2))).tolist(),
        shares=shares.tolist(),
        expected=expected.tolist(),
        settle_90_steps=_settle(shares),
        expected_settle_90_steps=_settle(expected),
        successes=sum(rollout.success for rollout in pushed),
        undisturbed_successes=sum(rollout.success for rollout in quiet),
    )


def _settle(shares: np.ndarray) -> int | None:
    """The first step with 90 %: once the arm grasps, or misses, the shares mean something else."""
    reached = np.flatnonzero(shares >= 0.9 - ROUNDING)
    return int(reached[0]) if reached.size else None


def _expected(settings: ExecutionSettings, event: int, length: int) -> np.ndarray:
    """The closed form, for as few old chunks as there are at ``event``."""
    kernel = filter_for(settings)
    if kernel is None:
        return np.empty(0)
    if settings.execution == "ensemble":
        shares = start_up_step(kernel, *ensemble_weights(settings), event)
    else:
        shares = kernel.step(wait=-event % settings.replan_interval)
    return np.concatenate([shares, np.ones(max(0, length - len(shares)))])[:length]


def _differences(quiet: Rollout, pushed: Rollout, event: int, length: int) -> tuple[np.ndarray, np.ndarray]:
    """Differences (length, joints) of commands and of newest chunks [rad]; NaN once an episode is over."""
    n = max(0, min(len(quiet.commands), len(pushed.commands), event + length) - event)
    commands = pushed.commands[event : event + n] - quiet.commands[event : event + n]
    opinions = _newest(pushed, event, n) - _newest(quiet, event, n)
    filled = np.full((2, length, len(_ARM_JOINTS)), np.nan)
    filled[:, :n] = np.stack([commands, opinions])[:, :, _ARM_JOINTS]
    return filled[0], filled[1]


def _newest(rollout: Rollout, start: int, n: int) -> np.ndarray:
    """The newest chunk's actions (n, A) for the steps from ``start`` on."""
    newest = {inference.step: inference.chunk for inference in rollout.inferences}
    actions = []
    for step in range(start, start + n):
        computed = max(s for s in newest if s <= step)
        actions.append(newest[computed][step - computed])
    return np.stack(actions) if actions else np.empty((0, len(JOINT_NAMES)))
