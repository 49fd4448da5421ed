"""The only place for index arithmetic over time."""

from dataclasses import dataclass

from act_chunking_runtime.number_checks import check_at_least
from lerobot_act_chunking.errors import ConfigurationError

MOST_STEPS = 100_000  # half an hour at 50 Hz; what is executed and observed is kept step by step


@dataclass(frozen=True)
class ChunkTiming:
    """Which steps a policy reads, predicts and executes, relative to the current step t.

    ==============  ==================================================  ==============
    what            steps                                               count
    ==============  ==================================================  ==============
    observations    t - (n_obs_steps - 1) * obs_stride ... t            n_obs_steps
    predictions     t, t + chunk_stride ... t + control_steps - 1       chunk_size
      first_obs     t - n_obs_steps + 1 ... t + control_steps - 1       horizon
    interpolated    t ... t + control_steps - 1                         control_steps
    used            t ... t + n_action_steps - 1                        n_action_steps
    next inference  t + replan_interval (`act_chunking_runtime.settings`)
    ==============  ==================================================  ==============

    Observations lie ``obs_stride`` steps apart. A chunk is the predictions from now on. With ``past_steps``
    the network also predicts as many steps before it, as Diffusion Policy does from the first observation on
    (``align=first_obs``).

    Raises:
        ConfigurationError: if a count is below 1, or a stride has nothing to lie between.
    """

    n_obs_steps: int
    chunk_size: int
    chunk_stride: int = 1
    past_steps: int = 0
    obs_stride: int = 1

    def __post_init__(self) -> None:
        check_at_least(
            1,
            n_obs_steps=self.n_obs_steps,
            chunk_size=self.chunk_size,
            chunk_stride=self.chunk_stride,
            obs_stride=self.obs_stride,
        )
        for name, n_steps in (
            (f"chunk_stride={self.chunk_stride} and chunk_size={self.chunk_size}", self.control_steps),
            (f"obs_stride={self.obs_stride} and n_obs_steps={self.n_obs_steps}", self.observed_steps),
        ):
            if n_steps > MOST_STEPS:
                raise ConfigurationError(
                    f"{name} span {n_steps} control steps, more than {MOST_STEPS}: set one of them to less"
                )
        if self.chunk_size == 1 and self.chunk_stride > 1:
            raise ConfigurationError(
                f"chunk_stride={self.chunk_stride} needs a chunk_size of 2 or more to interpolate between"
            )
        if self.n_obs_steps == 1 and self.obs_stride > 1:
            raise ConfigurationError(
                f"obs_stride={self.obs_stride} needs n_obs_steps of 2 or more to lie that far apart"
            )

    @property
    def control_steps(self) -> int:
        """Control steps that a chunk covers."""
        return (self.chunk_size - 1) * self.chunk_stride + 1

    @property
    def observed_steps(self) -> int:
        """Control steps from the first observation to the current one, both included."""
        return (self.n_obs_steps - 1) * self.obs_stride + 1

    def predictions_for(self, n_steps: int) -> int:
        """How many predictions decide the first ``n_steps`` control steps.

        Interpolation looks one prediction beyond the segment it is in.
        """
        if self.chunk_stride == 1:
            return n_steps
        return min(self.chunk_size, (n_steps - 2) // self.chunk_stride + 3)

    @property
    def observation_deltas(self) -> list[int] | None:
        """Steps of the observations; None for the current one alone, loaded without a time axis."""
        if self.n_obs_steps == 1:
            return None
        return [-age * self.obs_stride for age in reversed(range(self.n_obs_steps))]

    @property
    def action_deltas(self) -> list[int]:
        """Steps of the predicted actions."""
        return list(range(-self.past_steps * self.chunk_stride, self.control_steps, self.chunk_stride))

    @property
    def horizon(self) -> int:
        """Actions that the network predicts."""
        return self.past_steps + self.chunk_size

    def taught_steps(self, longest_episode: int) -> int:
        """First control steps of a chunk that demonstrations decide alone, however short they are.

        What lies behind the end of an episode is padding. Interpolation looks one prediction ahead, so the
        last segment before a prediction that is always padding is left out, too.

        Args:
            longest_episode: its length [control steps], at least 1.
        """
        n_predictions = (longest_episode - 1) // self.chunk_stride + 1
        if n_predictions >= self.chunk_size:
            return self.control_steps
        if self.chunk_stride == 1:
            return n_predictions
        return max(1, (n_predictions - 2) * self.chunk_stride + 1)


@dataclass(frozen=True)
class QueryTiming:
    """Which actions several action queries predict, each a chunk of its own (VQ-BeT, Lee et al. 2024).

    Query q = 0 belongs to the first observation of the window, the current one's is q = n_obs_steps - 1, and
    those behind it look further ahead. Each predicts the chunk that begins at its step:

    ===========  ==============================================================  ===============
    what         steps                                                           count
    ===========  ==============================================================  ===============
    queries      t - n_obs_steps + 1 ... t + n_action_pred_token - 1             n_queries
    chunk of q   (its step) + 0, chunk_stride, ..., control_steps - 1            chunk_size
    steps        all that any query predicts, each once, in order                len(steps)
    ===========  ==============================================================  ===============

    Attributes:
        chunk: observations, and the chunk of one query.
        n_action_pred_token: queries from the current one on (LeRobot's name).
    """

    chunk: ChunkTiming
    n_action_pred_token: int

    @property
    def n_queries(self) -> int:
        """Queries of the past, the present and the future."""
        return self.chunk.n_obs_steps - 1 + self.n_action_pred_token

    @property
    def steps(self) -> list[int]:
        """Steps of the actions that all queries together predict."""
        return sorted({step for chunk in self._chunks for step in chunk})

    @property
    def windows(self) -> list[list[int]]:
        """For each query the places of its chunk's actions in ``steps``: n_queries lists of chunk_size."""
        place = {step: i for i, step in enumerate(self.steps)}
        return [[place[step] for step in chunk] for chunk in self._chunks]

    @property
    def _chunks(self) -> list[list[int]]:
        first = 1 - self.chunk.n_obs_steps
        return [[q + step for step in self.chunk.action_deltas] for q in range(first, first + self.n_queries)]
