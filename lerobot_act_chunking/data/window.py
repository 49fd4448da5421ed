"""The observations that a policy of ``n_obs_steps`` acts on."""

from dataclasses import replace

from lerobot_act_chunking.data.batch import Observation
from lerobot_act_chunking.execution.environments import Environments
from lerobot_act_chunking.execution.history import ObservationHistory


class ObservationWindow:
    """`ObservationHistory` for `Observation`s; with one step it only holds on to the current one.

    Args:
        n_obs_steps: H, observations in the window.
        obs_stride: control steps from each to the next.
    """

    def __init__(self, n_obs_steps: int, obs_stride: int = 1):
        self._history = ObservationHistory(n_obs_steps, obs_stride) if n_obs_steps > 1 else None

    def reset(self, envs: Environments = None) -> None:
        """Forget the observations of these environments; all: equal to a fresh window."""
        if self._history is not None:
            self._history.reset(envs)

    def push(self, observation: Observation) -> None:
        """Add the current observation (B, ...) of every environment."""
        self._current = observation
        if self._history is not None:
            self._history.push({**observation.vectors, **observation.images})

    def stack(self, envs: Environments = None) -> Observation:
        """The windows (n, H, ...) of these environments, oldest observation first."""
        if self._history is None:
            current = self._current if envs is None else self._current.select(envs)
            return current.as_window()
        window = self._history.stack(envs)
        current = self._current if envs is None else self._current.select(envs)
        return replace(
            current,
            vectors={key: window[key] for key in self._current.vectors},
            images={key: window[key] for key in self._current.images},
        )
