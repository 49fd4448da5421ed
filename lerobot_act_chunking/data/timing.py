"""The only place for index arithmetic over time."""

from dataclasses import dataclass

from lerobot_act_chunking.errors import ConfigurationError


@dataclass(frozen=True)
class ChunkTiming:
    """Which steps a policy reads, predicts and executes, relative to the current step t.

    ==============  ====================================  =======
    what            steps                                 count
    ==============  ====================================  =======
    observations    t - n_obs_steps + 1 ... t             n_obs_steps
    predictions     t ... t + chunk_size - 1              chunk_size
    executed        t ... t + n_action_steps - 1          n_action_steps
    next inference  t + n_action_steps
    ==============  ====================================  =======

    Raises:
        ConfigurationError: if a count is below 1, or more steps are executed than predicted.
    """

    n_obs_steps: int
    chunk_size: int
    n_action_steps: int

    def __post_init__(self) -> None:
        for name in ("n_obs_steps", "chunk_size", "n_action_steps"):
            if getattr(self, name) < 1:
                raise ConfigurationError(f"{name}={getattr(self, name)} must be at least 1")
        if self.n_action_steps > self.chunk_size:
            raise ConfigurationError(
                f"n_action_steps={self.n_action_steps} exceeds chunk_size={self.chunk_size}: "
                "only predicted actions can be executed"
            )

    @property
    def observation_deltas(self) -> list[int] | None:
        """Steps of the observations; None for the current one alone, loaded without a time axis."""
        return None if self.n_obs_steps == 1 else list(range(1 - self.n_obs_steps, 1))

    @property
    def action_deltas(self) -> list[int]:
        """Steps of the predicted actions."""
        return list(range(self.chunk_size))

    def check_episode_length(self, longest_episode: int) -> None:
        """Refuse a dataset in which no episode is as long as one chunk.

        Raises:
            ConfigurationError: the end of every chunk would be padding, never data.
        """
        if self.chunk_size > longest_episode:
            raise ConfigurationError(
                f"chunk_size={self.chunk_size} is longer than the dataset's longest episode "
                f"({longest_episode} steps); set --policy.chunk_size to {longest_episode} or less"
            )
