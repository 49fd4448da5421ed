"""When to ask for a new chunk, and which action to execute meanwhile."""

from abc import ABC, abstractmethod
from collections.abc import Callable

from jaxtyping import Float
from torch import Tensor


class ChunkBuffer(ABC):
    """Holds predicted chunks and releases one action per step."""

    @abstractmethod
    def add(self, chunk: Float[Tensor, "B T A"]) -> None:
        """Take in a chunk whose first action is for the current step."""

    @abstractmethod
    def pop(self) -> Float[Tensor, "B A"]:
        """The action of the current step; moves on to the next step."""

    @abstractmethod
    def reset(self) -> None:
        """Forget everything."""


class NewestChunk(ChunkBuffer):
    """Follows the most recent chunk and nothing else."""

    def __init__(self):
        self._actions: list[Tensor] = []

    def add(self, chunk: Float[Tensor, "B T A"]) -> None:
        """Replace what is left of the previous chunk."""
        self._actions = list(chunk.unbind(1))[::-1]

    def pop(self) -> Float[Tensor, "B A"]:
        """The next action of the chunk."""
        return self._actions.pop()

    def reset(self) -> None:
        """Drop the chunk."""
        self._actions = []


class ChunkExecutor:
    """Asks for a chunk every ``n_action_steps`` control steps and executes from its buffer in between.

    All environments of a batch advance together. A different batch size can only mean another rollout, so
    it starts afresh as after `reset`.
    """

    def __init__(self, n_action_steps: int, buffer: ChunkBuffer):
        self.n_action_steps = n_action_steps
        self._buffer = buffer
        self._batch_size: int | None = None
        self._left = 0

    def __len__(self) -> int:
        """Control steps left before the next chunk is asked for."""
        return self._left

    def reset(self) -> None:
        """Start a new rollout: equal to a fresh executor."""
        self._buffer.reset()
        self._batch_size = None
        self._left = 0

    def step(self, predict: Callable[[], Float[Tensor, "B T A"]], batch_size: int) -> Float[Tensor, "B A"]:
        """The action of this control step.

        Args:
            predict: gives the chunk that starts now; called only when a new one is due.
            batch_size: number of environments now.
        """
        if batch_size != self._batch_size:
            self.reset()
            self._batch_size = batch_size
        if self._left == 0:
            self._buffer.add(predict())
            self._left = self.n_action_steps
        self._left -= 1
        return self._buffer.pop()
