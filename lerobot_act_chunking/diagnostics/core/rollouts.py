"""Episodes of a checkpoint in a simulation, with everything that a diagnosis needs written down.

Acts exactly as ``lerobot-eval`` (same observations, processors, batches, success rule), in this process and
without a vector environment: finished episodes cost nothing, and one network call serves all the others.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from inspect import signature
from typing import Any, Literal

import numpy as np
import torch
from lerobot.envs.configs import EnvConfig
from lerobot.envs.utils import preprocess_observation
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import Tensor

from lerobot_act_chunking.compat import action_of
from lerobot_act_chunking.diagnostics.core.drawing import drawing
from lerobot_act_chunking.diagnostics.core.success_keys import instead_of, success_key
from lerobot_act_chunking.diagnostics.core.worlds import (
    Worlds,
    failure_of,
    mode_of,
    open_worlds,
    rules_of,
    said,
    succeeded,
    task_description,
)
from lerobot_act_chunking.envs.aloha.env import AlohaSimEnv
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.execution.executor import ChunkExecutor
from lerobot_act_chunking.policies.loading import LoadedPolicy

OnStep = Callable[[int, int, Any], None]
OnChunk = Callable[[Tensor, Tensor | None], None]
Ending = Literal["terminated", "truncated", "cut"]
"""The environment said so; it ran out of its own time; or out of the configuration's ``episode_length``."""


@dataclass(frozen=True)
class Inference:
    """One network call for one episode.

    Attributes:
        step: control step whose observation the network saw.
        chunk: its prediction for the steps ``step``, ``step + 1``, ..., ``(T, A)`` in the environment's units
            (after the postprocessor); ``(0, A)`` where chunks were not logged.
    """

    step: int
    chunk: np.ndarray


@dataclass(frozen=True)
class Rollout:
    """One episode as it was commanded and as it came out.

    Attributes:
        seed: of the episode.
        dt: control period [s].
        commands: what the policy asked for, ``(T, A)`` in the environment's units.
        positions: where the joints were when it asked, ``(T, A)`` in the same units; ``(T, 0)`` where actions
            are no positions.
        rewards: the reward after each step, ``(T,)``.
        success: whether the environment said so at any step, as LeRobot counts, by ``is_success`` or the key
            that was named for it.
        inferences: network calls while the episode was running, in order; none if the policy neither has a
            `ChunkExecutor` nor calls its own ``predict_action_chunk`` (LeRobot's ``smolvla``).
        states: ``agent_pos`` as it was observed before each step, ``(T, S)``; ``(T, 0)`` where it is not.
        rules: every success rule that the environment reports, as of the last step.
        ending: why the episode ended.
        failure: what went wrong, where the environment can tell.
        mode: which of several ways it went, as the last ``info["mode"]`` says: -1 for none; None if nothing.
        acting_s: time from the observation to the command at each step, ``(T,)`` [s], for all episodes that
            ran together.
        instead: what ``info`` named in place of the success key; None where the key was there.
    """

    seed: int
    dt: float
    commands: np.ndarray
    positions: np.ndarray
    rewards: np.ndarray
    success: bool
    inferences: tuple[Inference, ...] = ()
    states: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))
    rules: Mapping[str, bool] = field(default_factory=dict)
    ending: Ending = "cut"
    failure: str | None = None
    mode: int | None = None
    acting_s: np.ndarray = field(default_factory=lambda: np.empty(0))
    instead: Sequence[str] | None = None


def roll_out(
    policy: LoadedPolicy,
    env_config: EnvConfig,
    seeds: Sequence[int],
    *,
    n_envs: int = 50,
    log_chunks: bool = True,
    on_step: OnStep | None = None,
    progress: Callable[[int], None] | None = None,
    given: Mapping[int, np.ndarray] | None = None,
    draw: int = 0,
) -> list[Rollout]:
    """Run one episode per seed, ``n_envs`` at a time.

    Each group of ``n_envs`` starts with ``policy.reset()`` and keeps its batch size to the end. What a policy
    of this package draws follows from its ``noise_seed``, the episode's seed and ``draw``; what another draws
    from the seed of the group's first episode and ``draw``, and so depends on ``n_envs``. Other results do
    only as far as the network's rounding depends on the batch size.

    Args:
        policy: any LeRobot policy with its processors.
        env_config: any of LeRobot's; `environment_of` gives the one that fits a policy.
        seeds: one per episode.
        n_envs: episodes that run together.
        log_chunks: keep every predicted chunk; ``4 T A`` bytes per network call and episode.
        on_step: called with ``(seed, step, environment)``, wrapped, when a command is chosen and before it is
            carried out; what it changes in the world is first seen in the next observation.
        progress: called with the number of finished episodes whenever it grows.
        given: commands (t, A) of some episodes, by their seeds, that are carried out in place of the policy's
            at their first t steps; the policy sees what comes of them, and goes on from there.
        draw: which of several independent draws of the policy's noise.

    Returns:
        One rollout per seed, in the order of ``seeds``.

    Raises:
        ConfigurationError: no seeds, no environments, or an environment that cannot be made here.
    """
    if not seeds or n_envs < 1:
        raise ConfigurationError(
            f"a rollout needs seeds and environments, got {len(seeds)} and n_envs={n_envs}"
        )
    if getattr(policy.policy.config, "background", False):  # what comes of it would depend on the machine
        policy.policy.config.background = False
    worlds = open_worlds(env_config, min(n_envs, len(seeds)), policy.policy.config)
    finished: list[Rollout] = []
    try:
        for first in range(0, len(seeds), len(worlds.envs)):
            group = [
                _Episode(seed, env, env_config, worlds.reset_options, (given or {}).get(seed, ()))
                for seed, env in zip(seeds[first : first + len(worlds.envs)], worlds.envs, strict=False)
            ]
            drawn = drawing(policy.policy, draw, seeds[first])
            with drawn, _observed_chunks(policy, group, log_chunks):
                for _ in range(worlds.episode_length):
                    if not _advance(policy, worlds, group, on_step):
                        break
                    if progress is not None:
                        progress(len(finished) + sum(episode.done for episode in group))
            finished += [episode.rollout() for episode in group]
            if progress is not None:
                progress(len(finished))
    finally:
        worlds.close()
    return finished


@dataclass
class _Episode:
    """An episode under way."""

    seed: int
    env: Any
    env_config: EnvConfig
    reset_options: dict[str, Any] | None = None
    given: Sequence[np.ndarray] | np.ndarray = ()
    commands: list[np.ndarray] = field(default_factory=list)
    positions: list[np.ndarray] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)
    inferences: list[Inference] = field(default_factory=list)
    states: list[np.ndarray] = field(default_factory=list)
    acting_s: list[float] = field(default_factory=list)
    info: Mapping[str, Any] = field(default_factory=dict)
    named: set[str] = field(default_factory=set)
    success: bool = False
    ending: Ending = "cut"
    done: bool = False

    def __post_init__(self) -> None:
        self.observation, _ = self.env.reset(seed=self.seed, options=self.reset_options)
        self.task = task_description(self.env)

    def advance(self, command: np.ndarray, acting_s: float, on_step: OnStep | None) -> None:
        """Carry out one command (A,), which took so long to choose, or the one that is given."""
        if len(self.commands) < len(self.given):
            command = self.given[len(self.commands)]
        self.acting_s.append(acting_s)
        self.positions.append(_positions(self.env))
        self.states.append(np.ravel(self.observation.get("agent_pos", ())))
        if on_step is not None:
            on_step(self.seed, len(self.commands), self.env)
        self.observation, reward, terminated, truncated, self.info = self.env.step(command)
        self.named.update(said(self.info))
        self.success |= succeeded(self.info, success_key(self.env_config))
        self.done = terminated or truncated
        if self.done:
            self.ending = "terminated" if terminated else "truncated"
        self.commands.append(command)
        self.rewards.append(reward)

    def rollout(self) -> Rollout:
        """All that was written down."""
        return Rollout(
            seed=self.seed,
            dt=1 / self.env_config.fps,
            commands=np.stack(self.commands),
            positions=np.stack(self.positions),
            rewards=np.array(self.rewards),
            success=self.success,
            states=np.stack(self.states),
            rules=rules_of(self.info),
            ending=self.ending,
            failure=None if self.success else failure_of(self.env),
            mode=mode_of(self.info),
            acting_s=np.array(self.acting_s),
            inferences=tuple(self.inferences),
            instead=instead_of(self.env_config, self.named),
        )


def _positions(env: Any) -> np.ndarray:
    """In the unit of the actions: ALOHA's are joint positions, those of gymnasium-robotics are not."""
    bare = env.unwrapped
    return bare.world.qpos() if isinstance(bare, AlohaSimEnv) else np.empty(0)


def _advance(policy: LoadedPolicy, worlds: Worlds, group: list[_Episode], on_step: OnStep | None) -> bool:
    """One control step of every unfinished episode; False once there is none."""
    if all(episode.done for episode in group):
        return False
    started = time.perf_counter()
    # Finished episodes stay in the batch with their last observation: its size must not change.
    observation = preprocess_observation(_stack([episode.observation for episode in group]))
    observation["task"] = [episode.task for episode in group]  # pyright: ignore[reportArgumentType]
    batch = policy.preprocessor(worlds.before(observation))
    with torch.inference_mode():
        actions = policy.postprocessor(action_of(policy.policy.select_action(batch)))
    commands = worlds.after(actions).to("cpu").numpy()
    acting_s = time.perf_counter() - started
    for episode, command in zip(group, commands, strict=True):
        if not episode.done:
            episode.advance(command, acting_s, on_step)
    return True


def _stack(observations: list[dict[str, Any]]) -> dict[str, Any]:
    """Observations of single environments as one batch, as a vector environment gives them."""
    first = observations[0]
    return {
        key: _stack([observation[key] for observation in observations])
        if isinstance(value, dict)
        else np.stack([observation[key] for observation in observations])
        for key, value in first.items()
    }


@contextmanager
def _observed_chunks(policy: LoadedPolicy, group: list[_Episode], log_chunks: bool) -> Iterator[None]:
    """Reset the policy and note every chunk it predicts in the episodes that it is for."""

    def note(chunk: Tensor, envs: Tensor | None) -> None:
        rows = range(len(group)) if envs is None else envs.tolist()
        actions = _in_environment_units(policy, chunk) if log_chunks else chunk[:, :0].to("cpu").numpy()
        for row, plan in zip(rows, actions, strict=True):
            episode = group[row]
            if not episode.done:
                episode.inferences.append(Inference(len(episode.commands), plan.copy()))

    reset_episodes(policy.policy, [episode.seed for episode in group])
    executor = getattr(policy.policy, "_action_queue", None)
    if isinstance(executor, ChunkExecutor):
        executor.on_chunk = lambda event: note(event.chunk, event.envs)
        try:
            yield
        finally:
            executor.on_chunk = None
    else:
        with _observed_predictions(policy.policy, note):
            yield


def reset_episodes(policy: PreTrainedPolicy, seeds: Sequence[int]) -> None:
    """Begin episodes with these seeds in the environments 0, 1, ...; LeRobot's policies do not take seeds."""
    if "episode_seeds" in signature(policy.reset).parameters:
        policy.reset(episode_seeds=seeds)  # pyright: ignore[reportCallIssue]
    else:
        policy.reset()


def _in_environment_units(policy: LoadedPolicy, chunk: Tensor) -> np.ndarray:
    """A chunk (n, T, A) through the postprocessor, which is made for single actions (n, A)."""
    return policy.postprocessor(chunk.flatten(0, 1)).to("cpu").numpy().reshape(chunk.shape)


@contextmanager
def _observed_predictions(policy: Any, note: OnChunk) -> Iterator[None]:
    """LeRobot's own policies have no executor; their ``select_action`` calls ``predict_action_chunk``."""
    predict = policy.predict_action_chunk

    def predict_and_note(*args: Any, **kwargs: Any) -> Any:
        output = predict(*args, **kwargs)
        note(action_of(output), None)
        return output

    policy.predict_action_chunk = predict_and_note
    try:
        yield
    finally:
        del policy.predict_action_chunk
