"""Episodes of the policy as it is, with all commands, in a folder that can be gone on with."""

import io
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_act_chunking.data.dimension_names import is_hand
from lerobot_act_chunking.diagnostics.core.played import Episode, describe
from lerobot_act_chunking.diagnostics.core.rollouts import Rollout
from lerobot_act_chunking.durable_files import write_atomically
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.json_files import read_json

MOTION = ("commands", "states", "rewards")


@dataclass(frozen=True)
class Record:
    """An episode.

    Attributes:
        episode: how it went.
        commands: (T, A).
        states: the robot's before each of them, (T, S); (T, 0) where they are not observed.
        rewards: behind each of them, (T,).
        dt: control period [s].
    """

    episode: Episode
    commands: np.ndarray
    states: np.ndarray
    rewards: np.ndarray
    dt: float

    @property
    def progress_ended(self) -> int:
        """The last step that brought a higher reward than all before it; that of the end if none did."""
        best = np.maximum.accumulate(self.rewards)
        rose = np.flatnonzero(np.diff(best, prepend=best[:1]) > 0)
        return int(rose[-1]) if len(rose) else len(self.rewards) - 1


def make_record(rollout: Rollout, names: Sequence[str]) -> Record:
    """What is kept of a rollout.

    Args:
        rollout: the episode.
        names: of the action's dimensions.
    """
    arms = [dim for dim, name in enumerate(names) if not is_hand(name)] or list(range(len(names)))
    return Record(
        episode=describe(rollout, arms),
        commands=rollout.commands,
        states=rollout.states,
        rewards=rollout.rewards,
        dt=rollout.dt,
    )


def keep(records: Sequence[Record], path: Path) -> None:
    """Write a group of episodes into ``path.npz`` and ``path.json``."""
    motion = {
        f"{name}_{place}": getattr(record, name) for place, record in enumerate(records) for name in MOTION
    }
    file = io.BytesIO()
    np.savez_compressed(file, **motion)  # pyright: ignore[reportArgumentType]
    write_atomically(path.with_suffix(".npz"), file.getvalue())
    content = {"dt": records[0].dt, "episodes": [asdict(each.episode) for each in records]}
    write_atomically(path.with_suffix(".json"), (json.dumps(content, indent=1) + "\n").encode())


def read_kept(path: Path) -> list[Record] | None:
    """A group of episodes, if it is there.

    Raises:
        ConfigurationError: its files are damaged.
    """
    if not path.with_suffix(".json").exists():
        return None
    try:
        content: Any = read_json(path.with_suffix(".json"))
        with np.load(path.with_suffix(".npz")) as file:
            return [
                Record(Episode(**each), *(file[f"{name}_{place}"] for name in MOTION), dt=content["dt"])
                for place, each in enumerate(content["episodes"])
            ]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigurationError(
            f"{path}.json cannot be read ({error!r}): remove it, and its episodes run again"
        ) from error
