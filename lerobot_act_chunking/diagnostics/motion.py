"""What a policy makes the robot do: one episode, its commands, its motion, its pictures."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.loading import load_policy

FILMSTRIP_FRAMES = 6


@dataclass(frozen=True)
class Motion:
    """One episode as it was commanded and as it came out.

    Attributes:
        dt: control period [s].
        commands: what the policy asked for, ``(T, A)`` in the environment's units.
        positions: where the joints were when it asked, ``(T, A)`` in the same units.
        rewards: the reward after each step, ``(T,)``.
        frames: ``(step, image)`` pairs, images ``(H, W, 3)`` uint8.
        replan_interval: steps between two chunks, or None where that is not known.
    """

    title: str
    dt: float
    joint_names: Sequence[str]
    commands: np.ndarray
    positions: np.ndarray
    rewards: np.ndarray
    success: bool
    replan_interval: int | None = None
    frames: list[tuple[int, np.ndarray]] = field(default_factory=list)


def record_motion(policy_path: str, *, task: str, seed: int, success: str = "touch") -> Motion:
    """Run one episode of a checkpoint in ``aloha_sim``, through the same processors as ``lerobot-eval``.

    Args:
        policy_path: checkpoint folder or repo id of any LeRobot policy trained on ``aloha_sim``.
        task: ``transfer_cube`` or ``insertion``.
        seed: seed of the episode's object pose.
        success: the rule that ends the episode, ``touch`` or ``hold``.

    Raises:
        ConfigurationError: no such checkpoint, or it asks for observations the environment does not have.
    """
    import torch
    from lerobot.envs.factory import make_env
    from lerobot.envs.utils import preprocess_observation

    policy, preprocessor, postprocessor = load_policy(policy_path)
    env_config = environment_for(policy.config, task=task, success=success)
    env: Any = next(iter(make_env(env_config, n_envs=1).values()))[0]
    commands, positions, rewards, frames, succeeded = [], [], [], [], False
    try:
        observation, _ = env.reset(seed=seed)
        policy.reset()
        horizon = env_config.episode_length
        every = max(1, horizon // 40)
        while len(commands) < horizon:
            if len(commands) % every == 0:
                frames.append((len(commands), env.envs[0].render()))
            positions.append(env.envs[0].unwrapped.world.qpos())
            batch = preprocessor({**preprocess_observation(observation), "task": [task]})
            with torch.inference_mode():
                action = postprocessor(policy.select_action(batch)).cpu().numpy()
            observation, reward, terminated, truncated, info = env.step(action)
            commands.append(action[0])
            rewards.append(float(reward[0]))
            if terminated[0] or truncated[0]:
                succeeded = bool(info["final_info"]["is_success"][0])
                break
    finally:
        env.close()
    return Motion(
        title=f"{policy.config.type} on {task}, seed {seed}: {'success' if succeeded else 'failure'}",
        dt=1 / env_config.fps,
        joint_names=joint_names(),
        commands=np.stack(commands),
        positions=np.stack(positions),
        rewards=np.array(rewards),
        success=succeeded,
        replan_interval=getattr(policy.config, "n_action_steps", None),
        frames=frames,
    )


def joint_names() -> Sequence[str]:
    """The names of the 14 command dimensions."""
    from lerobot_act_chunking.envs.aloha.world import JOINT_NAMES

    return JOINT_NAMES


def environment_for(config: Any, *, task: str, success: str) -> Any:
    """The ``aloha_sim`` configuration whose observations are the ones a policy was trained on.

    Raises:
        ConfigurationError: cameras of different sizes, or cameras together with object poses.
    """
    from lerobot_act_chunking.envs.configuration_envs import AlohaSimEnvConfig

    quick: dict[str, Any] = {"task": task, "success": success, "render_quality": "fast"}
    images = config.image_features
    if not images:
        return AlohaSimEnvConfig(
            **quick, obs_type="state", agent_vel="observation.agent_vel" in config.input_features
        )
    sizes = {tuple(feature.shape[-2:]) for feature in images.values()}
    if len(sizes) > 1:
        raise ConfigurationError(f"aloha_sim renders one image size, the policy wants {sorted(sizes)}")
    height, width = sizes.pop()
    return AlohaSimEnvConfig(
        **quick,
        obs_type="pixels_state" if "observation.state" in config.input_features else "pixels",
        cameras=[key.removeprefix("observation.images.") for key in images],
        observation_height=height,
        observation_width=width,
    )


def plot_motion(motion: Motion, path: Path) -> Path:
    """Draw a motion as a film strip, both arms' joints, both grippers and the reward, into a PNG."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 10), layout="constrained")
    film, plots = cast("tuple[Any, Any]", figure.subfigures(2, 1, height_ratios=[1, 4]))
    film.suptitle(motion.title)
    _draw_film(film, motion)
    axes = plots.subplots(4, 1, sharex=True, height_ratios=[3, 3, 1.5, 1])
    half = len(motion.joint_names) // 2
    _draw_joints(axes[0], motion, range(half - 1), "left arm [rad]")
    _draw_joints(axes[1], motion, range(half, 2 * half - 1), "right arm [rad]")
    _draw_joints(axes[2], motion, [half - 1, 2 * half - 1], "grippers\n(1 is open)")
    time = np.arange(len(motion.rewards)) * motion.dt
    axes[3].step(time, motion.rewards, where="post", color="tab:green")
    axes[3].set(ylabel="reward", xlabel="time [s]", xlim=(0, time[-1] + motion.dt))
    axes[3].margins(y=0.15)
    plots.align_ylabels(axes)
    for ax in axes:
        _draw_replans(ax, motion)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    return path


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
        ax.plot(time, motion.positions[:, joint], color=line.get_color(), linewidth=0.8, linestyle=":")
    ax.set_ylabel(label)
    ax.legend(loc="center left", bbox_to_anchor=(1, 0.5), fontsize=8, title="command (dotted: motion)")


def _short(name: str) -> str:
    return name.replace("_arm_", " ").replace("_", " ")


def _draw_replans(ax: Any, motion: Motion) -> None:
    """A faint line wherever the policy planned a new chunk."""
    if motion.replan_interval and motion.replan_interval > 1:
        for step in range(0, len(motion.commands), motion.replan_interval):
            ax.axvline(step * motion.dt, color="0.85", linewidth=0.8, zorder=0)
