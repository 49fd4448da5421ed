"""`act_chunking_runtime.executor` for tensors, on any device and in any precision."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from act_chunking_runtime.background import make_executor
from act_chunking_runtime.executor import ChunkEvent
from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.execution.arrays import array_of
from lerobot_act_chunking.execution.environments import Environments

CAST = ("cuda", "cpu")  # devices that may compute in another precision

# Gives the chunks (n, T, A) that start now for the environments asked for (None: all); (N, n, T, A) if the
# mode chooses among N samples.
Predict = Callable[[Environments], Float[Tensor, "*N n T A"]]
# Sees to all that such a chunk depends on, for the environments asked for and the control steps that it will
# be late; what it gives computes the chunk, in any thread.
Prepare = Callable[[Environments, int], Callable[[], Float[Tensor, "*N n T A"]]]


class ChunkExecutor:
    """Asks for a chunk every ``replan_interval`` control steps and executes as ``settings`` say in between.

    All environments of a batch advance together, but each may be reset alone, and only those that need a new
    chunk are asked for one. A different batch size can only mean another rollout, so it starts afresh. With
    ``background`` chunks are computed in a thread. Actions have the device and the precision of the chunks.

    Attributes:
        arrays: the executor of the runtime, which does the work.
        on_chunk: called with every chunk taken in, for instruments.
    """

    def __init__(self, settings: ExecutionSettings):
        self.arrays = make_executor(settings)
        self.arrays.on_chunk = self._tell
        self.on_chunk: Callable[[ChunkEvent[Tensor]], None] | None = None
        self._like = torch.empty(0)

    @property
    def settings(self) -> ExecutionSettings:
        """How chunks are executed."""
        return self.arrays.settings

    @property
    def n_steps(self) -> int:
        """Control steps since the last full reset."""
        return self.arrays.n_steps

    def __len__(self) -> int:
        """Control steps left before the next chunk is asked for."""
        return len(self.arrays)

    def reset(self, envs: Tensor | Sequence[int] | None = None) -> None:
        """Start a new rollout, in all environments (equal to a fresh executor) or in these alone.

        Args:
            envs: their indices, or a mask over all.
        """
        self.arrays.reset(None if envs is None else np.asarray(torch.as_tensor(envs, device="cpu")))

    def clear(self, envs: Environments = None) -> None:
        """Drop the actions that wait: the next step asks for a chunk in these environments; None for all.

        All else goes on: time, what was executed, what was learned from the rollout. LeRobot's
        ``drop_queued_actions`` calls this when the instruction changes within an episode.
        """
        self.arrays.clear(None if envs is None else envs.numpy())

    def step(self, predict: Predict, batch_size: int) -> Float[Tensor, "B A"]:
        """The action of this control step.

        Args:
            predict: called only if a chunk is due, with the environments that need one.
            batch_size: number of environments now.

        Raises:
            ValueError: a chunk is shorter than ``n_action_steps``, or not for the environments asked for.
        """
        action = self.arrays.step(lambda envs: self._taken(predict(_indices(envs))), batch_size)
        return self._given(action)

    def advance(self, prepare: Prepare, batch_size: int) -> Float[Tensor, "B A"]:
        """The action of this control step, as `step`, of a policy whose chunks may be computed elsewhere.

        Args:
            prepare: called only if a chunk is due, and with ``background`` none is being computed.
            batch_size: number of environments now.

        Raises:
            ValueError: as `step`.
            ConfigurationError: with ``background``, several environments, or chunks that come too late.
        """

        def prepared(envs: np.ndarray | None, delay: int) -> Callable[[], np.ndarray]:
            compute = _as_here(prepare(_indices(envs), delay))
            return lambda: self._taken(compute())

        return self._given(self.arrays.advance(prepared, batch_size))

    def add(self, chunk: Float[Tensor, "*N n T A"], envs: Environments = None, delay: int = 0) -> None:
        """Take in a chunk whose first action is for the current step; for callers who keep time themselves.

        Args:
            chunk: as from ``predict``.
            envs: the environments it is for; None for all.
            delay: steps that its computation will have taken: the older plan goes on for as long.

        Raises:
            ValueError: as `step`.
        """
        self.arrays.add(self._taken(chunk), None if envs is None else envs.cpu().numpy(), delay)

    def pop(self) -> Float[Tensor, "B A"]:
        """The action of the current step; the last one is held if no chunk covers it."""
        return self._given(self.arrays.pop())

    def plan(self, envs: Environments = None) -> tuple[Float[Tensor, "n T A"], Bool[Tensor, "r T"]]:
        """What would be executed from the current step on without a further chunk, and the steps it covers.

        Empty before the first chunk. Covered has one row for all environments, or one for each.
        """
        steps, covered = self.arrays.plan(None if envs is None else envs.cpu().numpy())
        return torch.from_numpy(steps.copy()).to(self._like.device), torch.from_numpy(covered)

    def _taken(self, chunk: Tensor) -> np.ndarray:
        self._like = chunk.new_empty(0)
        return array_of(chunk)

    def _given(self, array: np.ndarray) -> Tensor:
        return torch.from_numpy(array).to(self._like)

    def _tell(self, event: ChunkEvent[np.ndarray]) -> None:
        if self.on_chunk is not None:
            self.on_chunk(ChunkEvent(event.step, _indices(event.envs), self._given(event.chunk)))


def _indices(envs: np.ndarray | None) -> Environments:
    return None if envs is None else torch.from_numpy(envs)


def _as_here[R](compute: Callable[[], R]) -> Callable[[], R]:
    """The same computation in this thread's modes of PyTorch, which another thread does not have."""
    grad = torch.is_grad_enabled()
    casts = {kind: torch.get_autocast_dtype(kind) for kind in CAST if torch.is_autocast_enabled(kind)}

    def run() -> R:
        with ExitStack() as modes:
            modes.enter_context(torch.inference_mode(False))
            modes.enter_context(torch.set_grad_enabled(grad))
            for kind, dtype in casts.items():
                modes.enter_context(torch.autocast(kind, dtype))
            return compute()

    return run
