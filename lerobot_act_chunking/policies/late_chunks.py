"""The end of a rollout in real time in which every chunk comes too late, or cannot be computed."""

import functools
import logging
import sys
import weakref
from collections.abc import Callable
from typing import Any

from lerobot_act_chunking.errors import ActChunkingError, ConfigurationError
from lerobot_act_chunking.policies.execution_fields import ExecutionFields

ENGINE = "lerobot.rollout.inference.rtc"
PATIENCE = 3  # chunks: the first may be late because everything is slow once

logger = logging.getLogger(__name__)
failures: weakref.WeakKeyDictionary[Any, list[ActChunkingError]] = weakref.WeakKeyDictionary()
"""Errors of this package while a policy predicted in the engine's thread, by policy."""


class LateChunks:
    """Counts the chunks in a row that were computed for so long that none of their actions is left.

    Args:
        fps: control steps per second.
    """

    def __init__(self, fps: float):
        self._fps = fps
        self._newest: Any = None
        self._n_late = 0

    def check(self, queue: Any) -> None:
        """Check LeRobot's queue, which holds what is left of the newest chunk.

        Raises:
            ConfigurationError: `PATIENCE` chunks in a row came too late, so that the robot stands still.
        """
        chunk = queue.original_queue
        if chunk is None or chunk is self._newest:
            return
        self._newest, self._n_late = chunk, 0 if len(chunk) else self._n_late + 1
        if self._n_late == 1:
            logger.warning("a chunk took longer to compute than it lasts: none of its actions can be used")
        if self._n_late >= PATIENCE:
            raise ConfigurationError(
                f"{PATIENCE} chunks in a row took longer to compute than they last at {self._fps:g} control "
                "steps per second, so the robot does not move: let it wait for each chunk "
                "(--inference.type=sync), or compute faster (a GPU, fewer inference steps, a smaller policy)"
            )


def install(policy: Any = None) -> None:
    """Let LeRobot's real-time engine end with a reason where a policy of this package cannot act in it.

    The engine drops what comes too late and asks again: the robot stands still and nothing is said. It logs
    an error of the policy ten times, and the command ends as if all were well. Here the thread of the
    control loop raises, so that the robot is let go in order and the command fails. Harmless when repeated;
    nothing happens before LeRobot's engine is imported, or if it is another than 0.6.1's.

    Args:
        policy: the one that will act, if it is there already.
    """
    if policy in failures:
        failures[policy].clear()  # a new rollout
    elif policy is not None:
        failures[policy] = []
        policy.predict_action_chunk = _noting(policy.predict_action_chunk, failures[policy])
    module = sys.modules.get(ENGINE)
    if module is None or hasattr(module.RTCInferenceEngine.get_action, "__wrapped__"):
        return
    if not {"_policy", "_fps"} <= set(module.RTCInferenceEngine.__init__.__code__.co_names):
        logger.warning("LeRobot's real-time engine is a new one: a policy too slow for it is not noticed")
        return
    module.RTCInferenceEngine.get_action = _watched(module.RTCInferenceEngine.get_action)


def _watched(get_action: Callable[..., Any]) -> Callable[..., Any]:
    watches: weakref.WeakKeyDictionary[Any, LateChunks] = weakref.WeakKeyDictionary()

    @functools.wraps(get_action)
    def watched(engine: Any, obs_frame: dict[str, Any] | None) -> Any:
        if not isinstance(engine._policy.config, ExecutionFields):
            return get_action(engine, obs_frame)
        if noted := failures.get(engine._policy):
            raise noted[0]
        queue = engine.action_queue
        if queue is not None and not hasattr(queue.merge, "__wrapped__"):
            _go_on_where_it_is(queue)
        action = get_action(engine, obs_frame)
        if queue is not None:
            watches.setdefault(engine, LateChunks(engine._fps)).check(queue)
        limits = getattr(engine._policy, "limits", None)
        return action if action is None or limits is None else limits(action[None])[0]

    return watched


def _go_on_where_it_is(queue: Any) -> None:
    """Let a chunk follow on what was executed while it was computed, in LeRobot's queue.

    LeRobot leaves out as many actions of it as time has passed, rounded up. Where the loop is slower than
    ``--fps``, and by the rounding, these are more than were executed: the robot would leap over the others.
    A chunk that comes too late altogether still counts as such.
    """
    merge, n_new = queue.merge, 0

    def executed(real_delay: int, before: int | None = None) -> int:
        late = before is None or real_delay >= n_new
        return max(0, real_delay if late else queue.last_index - before)

    @functools.wraps(merge)
    def merging(original_actions: Any, *args: Any, **arguments: Any) -> None:
        nonlocal n_new
        n_new = len(original_actions)
        merge(original_actions, *args, **arguments)

    queue.merge, queue._check_and_resolve_delays = merging, executed


def _noting(predict: Callable[..., Any], noted: list[ActChunkingError]) -> Callable[..., Any]:
    @functools.wraps(predict)
    def predicting(*args: Any, **arguments: Any) -> Any:
        try:
            return predict(*args, **arguments)
        except ActChunkingError as error:
            noted.append(error)
            raise

    return predicting
