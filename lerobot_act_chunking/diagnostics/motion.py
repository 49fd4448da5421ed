"""What a policy makes the robot do: one episode, its commands, its motion, its pictures."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np

from lerobot_act_chunking.diagnostics.core.environments import (
    EnvironmentSpec,
    action_names,
    environment_of,
)
from lerobot_act_chunking.diagnostics.core.rollouts import roll_out
from lerobot_act_chunking.diagnostics.core.success_keys import never_said
from lerobot_act_chunking.diagnostics.core.training import untrained
from lerobot_act_chunking.diagnostics.core.worlds import episode_length
from lerobot_act_chunking.envs.aloha.tasks import JOINT_NAMES
from lerobot_act_chunking.policies.loading import check_complete, load_policy, read_config

FILMSTRIP_FRAMES = 6


@dataclass(frozen=True)
class Motion:
    """One episode as it was commanded and as it came out.

    Attributes:
        dt: control period [s].
        commands: what the policy asked for, ``(T, A)`` in the environment's units.
        joint_names: of the A dimensions; grippers have "gripper" in theirs.
        positions: where the joints were when it asked, ``(T, A)`` in the same units, or ``(T, 0)``.
        rewards: the reward after each step, ``(T,)``.
        frames: ``(step, image)`` pairs, images ``(H, W, 3)`` uint8.
        replans: steps at which the policy planned a new chunk, as far as known.
        success: None where nothing is known of it.
        untrained: the sentence that says so, if the policy is.
        never_said: the sentence that says that the environment says nothing of success, if it does not.
    """

    title: str
    dt: float
    joint_names: Sequence[str]
    commands: np.ndarray
    positions: np.ndarray
    rewards: np.ndarray
    success: bool | None
    replans: Sequence[int] = ()
    frames: list[tuple[int, np.ndarray]] = field(default_factory=list)
    untrained: str | None = None
    never_said: str | None = None


def record_motion(
    policy_path: str,
    environment: EnvironmentSpec,
    *,
    seed: int,
    progress: Callable[[int, int], None] | None = None,
) -> Motion:
    """Run one episode of a checkpoint, as ``lerobot-eval`` would.

    Args:
        policy_path: checkpoint folder or repo id of any LeRobot policy.
        environment: to run it in.
        seed: of the episode.
        progress: called with the numbers of control steps done and allowed.

    Raises:
        ConfigurationError: no such checkpoint, or an environment that cannot be made for it.
        FeatureError: a policy of another robot or control rate.
    """
    config = read_config(policy_path)
    check_complete(policy_path, config.type)
    env_config = environment_of(config, environment, policy_path)
    policy = load_policy(policy_path)
    frames: list[tuple[int, np.ndarray]] = []

    def film(_seed: int, step: int, env: Any) -> None:
        length = episode_length(env_config, env)
        if progress is not None:
            progress(step + 1, length)
        if step % max(1, length // 40) == 0:
            frames.extend((step, image) for image in _pictures(env))

    (rollout,) = roll_out(policy, env_config, [seed], on_step=film)
    unknown = never_said(env_config, [rollout.instead])
    outcome = "success unknown" if unknown else "success" if rollout.success else "failure"
    return Motion(
        title=f"{config.type} on {environment.name}, seed {seed}: {outcome}",
        untrained=untrained(policy_path),
        never_said=unknown,
        dt=rollout.dt,
        joint_names=action_names(env_config, rollout.commands.shape[1], policy_path),
        commands=rollout.commands,
        positions=rollout.positions,
        rewards=rollout.rewards,
        success=None if unknown else rollout.success,
        replans=[inference.step for inference in rollout.inferences],
        frames=frames,
    )


def _pictures(env: Any) -> Iterator[np.ndarray]:
    """The one of this moment, if the environment can be drawn."""
    with suppress(NotImplementedError):
        image = env.render()
        if image is not None:
            yield image


def plot_motion(motion: Motion, path: Path) -> Path:
    """Draw a motion as a film strip, the actions, the grippers and the reward, into a PNG."""
    from matplotlib.figure import Figure

    groups = _groups(motion.joint_names)
    heights = [1.5 if name.startswith("gripper") else 3 for name in groups]
    figure = Figure(figsize=(12, 3 + sum(heights)), layout="constrained")
    film, plots = cast("tuple[Any, Any]", figure.subfigures(2, 1, height_ratios=[1, 4]))
    film.suptitle(motion.title if motion.untrained is None else f"{motion.title} (untrained)")
    _draw_film(film, motion)
    axes = plots.subplots(len(groups) + 1, 1, sharex=True, height_ratios=[*heights, 1])
    for ax, (label, joints) in zip(axes[:-1], groups.items(), strict=True):
        _draw_joints(ax, motion, joints, label)
    time = np.arange(len(motion.rewards)) * motion.dt
    axes[-1].step(time, motion.rewards, where="post", color="tab:green")
    axes[-1].set(ylabel="reward", xlabel="time [s]", xlim=(0, time[-1] + motion.dt))
    axes[-1].margins(y=0.15)
    plots.align_ylabels(axes)
    for ax in axes:
        _draw_replans(ax, motion)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    return path


def _groups(joint_names: Sequence[str]) -> dict[str, list[int]]:
    """Which dimensions share a plot, by its label; units are known of ALOHA's alone."""
    radians, opening = (" [rad]", "\n(1 is open)") if tuple(joint_names) == JOINT_NAMES else ("", "")
    grippers = [joint for joint, name in enumerate(joint_names) if "gripper" in name]
    others = [joint for joint in range(len(joint_names)) if joint not in grippers]
    arms = {
        f"{side} arm{radians}": [j for j in others if joint_names[j].startswith(side)]
        for side in ("left", "right")
    }
    groups = arms if all(arms.values()) else {"actions": others}
    return groups | ({f"grippers{opening}": grippers} if grippers else {})


def _draw_film(figure: Any, motion: Motion) -> None:
    """Evenly spaced frames of the episode, first to last."""
    if not motion.frames:
        return
    chosen = np.linspace(0, len(motion.frames) - 1, FILMSTRIP_FRAMES).round().astype(int)
    for ax, index in zip(figure.subplots(1, FILMSTRIP_FRAMES), chosen, strict=True):
        step, image = motion.frames[index]
        ax.imshow(image)
        ax.set_title(f"{step * motion.dt:.1f} s", fontsize=9)
        ax.axis("off")


def _draw_joints(ax: Any, motion: Motion, joints: Sequence[int], label: str) -> None:
    """Commands as solid lines, positions as thin dark ones over them."""
    time = np.arange(len(motion.commands)) * motion.dt
    for joint in joints:
        (line,) = ax.plot(time, motion.commands[:, joint], label=_short(motion.joint_names[joint]))
        if motion.positions.size:
            ax.plot(time, motion.positions[:, joint], color=line.get_color(), linewidth=0.8, linestyle=":")
    ax.set_ylabel(label)
    title = "command (dotted: motion)" if motion.positions.size else "command"
    ax.legend(loc="center left", bbox_to_anchor=(1, 0.5), fontsize=8, title=title)


def _short(name: str) -> str:
    return name.replace("_arm_", " ").replace("_", " ")


def _draw_replans(ax: Any, motion: Motion) -> None:
    """A faint line wherever the policy planned a new chunk, unless that is everywhere."""
    if len(motion.replans) <= len(motion.commands) // 4:
        for step in motion.replans:
            ax.axvline(step * motion.dt, color="0.85", linewidth=0.8, zorder=0)
