"""New chunks that go on from the chunk in execution: real-time chunking in LeRobot's contract."""

from typing import Any

from jaxtyping import Bool, Float
from torch import Tensor

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.execution.environments import Environments
from lerobot_act_chunking.execution.executor import ChunkExecutor
from lerobot_act_chunking.execution.handover import hand_over
from lerobot_act_chunking.execution.plan import Plan, covered_steps
from lerobot_act_chunking.nn.prefix import GivenActions
from lerobot_act_chunking.policies import late_chunks


class ContinuesChunks:
    """What `ChunkedPolicy` does about the chunk in execution, its own or LeRobot's real-time engine's.

    An engine that executes chunks itself calls ``predict_action_chunk`` with

    - ``inference_delay``: control steps that computing the chunk will take. The observations then stand for a
      whole history, because engines show one only when they want a chunk;
    - ``prev_chunk_left_over`` (n, P, A): what is left of the chunk in execution, normalised, from the current
      step on; zeros behind its end do not count. The new chunk continues it as the policy was trained to, and
      goes over from it as ``execution`` says;
    - ``execution_horizon``: control steps of the left-over to continue; all by default.
    """

    config: Any
    _action_queue: ChunkExecutor

    def supports_rtc(self) -> bool:
        """Whether `predict_action_chunk` continues the chunk in execution (real-time chunking)."""
        return self.config.timing.past_steps == 0

    def init_rtc_processor(self) -> None:
        """Notice when chunks come too late or fail; LeRobot calls this before its real-time engine starts."""
        late_chunks.install(self)

    def _current_plan(self, envs: Environments, delay: int) -> Plan | None:
        """What is executed until a new chunk takes over, ``delay`` steps from now, and then without one."""
        steps, covered = self._action_queue.plan(envs)
        return self._plan(steps, covered, delay) if steps.numel() else None

    def _left_over(self, steps: Tensor | None, delay: int, execution_horizon: int | None) -> Plan | None:
        """The same of a chunk that LeRobot's real-time engine executes."""
        steps = self._to_continue(steps, execution_horizon)
        return None if steps is None else self._plan(steps, covered_steps(steps), delay)

    def _to_continue(
        self, steps: Tensor | None, execution_horizon: int | None
    ) -> Float[Tensor, "n P A"] | None:
        """What is left of a chunk, as far as it counts; None if nothing is to be continued.

        Raises:
            ConfigurationError: chunks begin before the current step.
        """
        if self.config.timing.past_steps and steps is not None:
            raise ConfigurationError("a chunk is continued from the current step on: set align=current")
        return to_continue(self.config, steps, execution_horizon)

    def _plan(self, steps: Float[Tensor, "n P A"], covered: Bool[Tensor, "r P"], delay: int) -> Plan | None:
        timing = self.config.timing
        return Plan.from_steps(
            steps, covered, horizon=timing.chunk_size, chunk_stride=timing.chunk_stride, delay=delay
        )

    def _handed_over(
        self, chunk: Float[Tensor, "n K A"], steps: Tensor | None, delay: int, execution_horizon: int | None
    ) -> Float[Tensor, "n K A"]:
        """The chunk, gone over to from what is left of the one in execution as ``execution`` says."""
        steps = self._to_continue(steps, execution_horizon)
        return continue_chunk(chunk, steps, delay, self._action_queue.settings)


def to_continue(config: Any, steps: Tensor | None, execution_horizon: int | None) -> Tensor | None:
    """What is left of the chunk that LeRobot's real-time engine executes (n, P, A), as far as it counts."""
    rtc = getattr(config, "rtc_config", None)
    if steps is None or not steps.numel() or (rtc is not None and not rtc.enabled):
        return None
    return (steps if steps.ndim == 3 else steps[None])[:, :execution_horizon]


def continue_chunk(
    chunk: Float[Tensor, "n K A"], steps: Tensor | None, delay: int, settings: ExecutionSettings
) -> Float[Tensor, "n K A"]:
    """The chunk, gone over to from ``steps``, if there are any; see `hand_over`."""
    return chunk if steps is None else hand_over(chunk, steps, covered_steps(steps), delay, settings)


def given_actions(plan: Plan | None, longest: int) -> GivenActions | None:
    """The first actions of a chunk that are executed while it is computed, at most ``longest`` of them."""
    if plan is None or not longest:
        return None
    frozen = plan.whole_tokens(1, longest)
    return GivenActions(frozen.actions[:, :longest], frozen.frozen[:, :longest])
