"""An exported policy: observations in, one action per control step out."""

from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from act_chunking_runtime.background import make_executor
from act_chunking_runtime.draws import Draws
from act_chunking_runtime.errors import ConfigurationError, FeatureError, need
from act_chunking_runtime.files import CHUNK, GRAPH, ActionSpec, Description
from act_chunking_runtime.limits import ActionLimits


class ExportedPolicy:
    """Acts from a graph, as the policy that was exported does.

    Args:
        description: of the policy.
        session: of ONNX Runtime over its graph.
        generator: draws all that is random.

    Attributes:
        limits: of what is executed, with counts of what they held back; None for none.
    """

    def __init__(self, description: Description, session: Any, generator: np.random.Generator):
        self.description = description
        self.limits = _limits_of(description.actions)
        self._session = session
        self._draws = Draws(description.draws, generator)
        self._executor = make_executor(description.execution)
        self._scale = np.array(description.actions.scale, dtype=np.float32)
        self._offset = np.array(description.actions.offset, dtype=np.float32)
        self._ages = [step * description.obs_stride for step in reversed(range(description.n_obs_steps))]
        self._seen: deque[dict[str, np.ndarray]] = deque(maxlen=self._ages[0] + 1)

    def reset(self) -> None:
        """Begin an episode: chunks, history and held draws of the one before are dropped."""
        self._executor.reset()  # waits for a chunk that is being computed
        self._draws.reset()
        self._seen.clear()
        if self.limits is not None:
            self.limits.reset()

    def act(self, observation: Mapping[str, Any]) -> np.ndarray:
        """The action (A,) of this control step, in the robot's units.

        Args:
            observation: each input by its name: vectors (S,), images uint8 (height, width, 3). Others are
                ignored.

        Raises:
            FeatureError: naming an input that is missing, or of another shape or type.
        """
        self._see({key: self._taken(observation, key) for key in self.description.inputs})
        action = self._executor.advance(self._prepare, 1)
        if self.limits is not None:
            action = self.limits.hold_normalised(action)
        return action[0] * self._scale + self._offset

    def predict(self, window: Mapping[str, np.ndarray], draws: Mapping[str, np.ndarray]) -> np.ndarray:
        """Normalised chunks (1, T, A) from the current step on, or N samples of them (N, 1, T, A).

        Args:
            window: the last observations (1, H, ...) of each input, oldest first.
            draws: the random numbers that the graph takes.
        """
        (chunks,) = self._session.run([CHUNK], {**window, **draws})
        return chunks if self.description.execution.n_samples else chunks[0]

    def _prepare(self, _envs: np.ndarray | None, _delay: int) -> Callable[[], np.ndarray]:
        window, draws = self._window(), self._draws.take(self._executor.n_steps)
        return lambda: self.predict(window, draws)

    def _see(self, observation: dict[str, np.ndarray]) -> None:
        self._seen.append(observation)
        while len(self._seen) < (self._seen.maxlen or 1):
            self._seen.appendleft(observation)  # the first stands in for those before it

    def _window(self) -> dict[str, np.ndarray]:
        return {
            key: np.stack([self._seen[-1 - age][key] for age in self._ages])[None]
            for key in self.description.inputs
        }

    def _taken(self, observation: Mapping[str, Any], key: str) -> np.ndarray:
        spec = self.description.inputs[key]
        if key not in observation:
            given = ", ".join(sorted(observation)) or "nothing"
            raise FeatureError(f"the policy needs {key!r}, but the observation has only: {given}")
        value = np.asarray(observation[key])
        images = spec.dtype == "uint8"
        if value.shape != spec.shape or (value.dtype == np.uint8) is not images:
            raise FeatureError(
                f"{key!r} is {value.dtype} {value.shape}, but the policy takes {spec.dtype} {spec.shape}"
            )
        return value.astype(spec.dtype)


def load(folder: str | Path, generator: np.random.Generator, *, n_threads: int = 1) -> ExportedPolicy:
    """Load what ``act-chunking export`` has written.

    Args:
        folder: with the graph and its description.
        generator: draws all that is random, as ``np.random.default_rng(0)``.
        n_threads: threads that compute a chunk.

    Raises:
        ConfigurationError: the folder is not complete, or ONNX Runtime is missing or cannot read the graph.
    """
    folder = Path(folder)
    description = Description.read(folder)
    graph = folder / GRAPH
    if not graph.is_file():
        raise ConfigurationError(f"{folder} holds no {GRAPH}: copy the whole folder")
    onnxruntime = need("onnxruntime", "an exported policy", "onnxruntime")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = n_threads, 1
    try:
        session = onnxruntime.InferenceSession(str(graph), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # a class of its own for each reason
        raise ConfigurationError(f"{graph} cannot be read by ONNX Runtime: {error}") from error
    return ExportedPolicy(description, session, generator)


def _limits_of(actions: ActionSpec) -> ActionLimits | None:
    if actions.low is actions.high is actions.change is None:
        return None
    none = [np.inf] * len(actions.names)
    bounds = {"low": actions.low or np.negative(none), "high": actions.high or none}
    bounds |= {"change": actions.change or none, "scale": actions.scale, "offset": actions.offset}
    return ActionLimits(actions.names, **{name: np.array(value) for name, value in bounds.items()})
