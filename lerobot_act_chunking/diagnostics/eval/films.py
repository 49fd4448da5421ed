"""Films of recorded episodes: the same commands from the same start, seen by the environment's camera."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.envs.configs import EnvConfig
from lerobot.utils.io_utils import write_video

from lerobot_act_chunking.diagnostics.core.played import Episode
from lerobot_act_chunking.diagnostics.core.success_keys import success_key
from lerobot_act_chunking.diagnostics.core.worlds import Worlds, open_worlds, succeeded
from lerobot_act_chunking.durable_files import publish, scratch_path

FPS = 25  # at most, of a film
WIDTH = 320  # pixels, at most twice as many


@dataclass(frozen=True)
class Film:
    """A film of an episode.

    Attributes:
        episode: the episode.
        path: of the MP4 file.
        faithful: whether the replay ended as the episode did.
    """

    episode: Episode
    path: Path
    faithful: bool


def choose(episodes: Sequence[Episode], n: int) -> list[int]:
    """Which episodes to show: failures before successes, one of each kind before a second one.

    Returns:
        Their places, the most frequent kind of failure first.
    """
    counts, seen = Counter(each.label for each in episodes), Counter[str | None]()
    order = []
    for place, each in enumerate(episodes):
        seen[each.label] += 1
        order.append((each.success, seen[each.label], -counts[each.label], place))
    return [place for *_, place in sorted(order)[:n]]


def film(
    env_config: EnvConfig, policy_config: Any, episodes: Sequence[tuple[Episode, np.ndarray]], folder: Path
) -> list[Film]:
    """Replay episodes and film them.

    Args:
        env_config: where they took place.
        policy_config: of the policy that acted.
        episodes: each with its commands (T, A).
        folder: for the files, ``seed_<seed>.mp4``.

    Raises:
        ConfigurationError: an environment that cannot be made here.
    """
    worlds = open_worlds(env_config, 1, policy_config)
    try:
        key = success_key(env_config)
        return [_film(worlds, env_config.fps, key, *each, folder) for each in episodes]
    finally:
        worlds.close()


def _film(worlds: Worlds, fps: int, key: str, episode: Episode, commands: np.ndarray, folder: Path) -> Film:
    (env,) = worlds.envs
    path, every = folder / f"seed_{episode.seed}.mp4", max(1, round(fps / FPS))
    env.reset(seed=episode.seed, options=worlds.reset_options)
    frames, success = [_small(env.render())], False
    for step, command in enumerate(commands, start=1):
        *_, info = env.step(command)
        success |= succeeded(info, key)
        if step % every == 0 or step == len(commands):
            frames.append(_small(env.render()))
    with scratch_path(folder) as part:
        named = part.with_suffix(".mp4")
        write_video(named, frames, round(fps / every))
        publish(named, path)
    return Film(episode, path, success == episode.success)


def _small(frame: np.ndarray) -> np.ndarray:
    """Every second, third, ... pixel, so that the film is at most twice `WIDTH` wide."""
    step = max(1, frame.shape[1] // WIDTH)
    return np.ascontiguousarray(frame[::step, ::step])
