"""Batches as other policies want to see them: some environments, repeated, with their history in place."""

from collections import deque
from typing import Any

import torch
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import ACTION, OBS_IMAGE, OBS_IMAGES
from torch import Tensor

from lerobot_act_chunking.errors import FeatureError
from lerobot_act_chunking.execution.environments import Environments
from lerobot_act_chunking.execution.history import ObservationHistory

Batch = dict[str, Any]


class InnerObservations:
    """What the inner policy observes: the batch, and for policies that keep a history in queues, that too.

    LeRobot's diffusion, vqbet, multi_task_dit and tdmpc read their history from ``_queues``, which only their
    ``select_action`` fills, one observation of all environments at a time. Here the history is kept outside,
    per environment, and written into the queues before each prediction.

    Args:
        inner: the policy; `for_prediction` fills its queues.
    """

    def __init__(self, inner: PreTrainedPolicy):
        self._inner = inner
        self._keys = [key for key in self._queues if key != ACTION]
        self._history = ObservationHistory(inner.config.n_obs_steps)

    @property
    def _queues(self) -> dict[str, deque]:
        return getattr(self._inner, "_queues", None) or {}

    def reset(self, envs: Environments = None) -> None:
        """Forget the history of these environments; None: of all."""
        self._history.reset(envs)

    def batch_size(self, batch: Batch) -> int:
        """Number of environments (B) in ``batch``.

        Raises:
            FeatureError: the batch holds no input of the policy, or has no batch axis.
        """
        inputs = self._inner.config.input_features or {}
        for key, feature in inputs.items():
            if key in batch:
                if tuple(batch[key].shape) == tuple(feature.shape) != (1,):
                    raise FeatureError(
                        f"{key!r} has shape {tuple(feature.shape)}, that of a single observation: give it a "
                        "batch axis, with unsqueeze(0)"
                    )
                return len(batch[key])
        raise FeatureError(f"the policy needs {', '.join(inputs)}, but the batch has only {', '.join(batch)}")

    def observe(self, batch: Batch) -> None:
        """Add the observations (B, ...) of this control step to the history."""
        self.batch_size(batch)  # before anything is kept of a batch that has none
        if self._keys:
            self._history.push(self._queued(batch))

    def for_prediction(self, batch: Batch, envs: Environments = None, n_samples: int = 1) -> Batch:
        """A batch for ``predict_action_chunk``, of which nothing is shared with ``batch`` but the images.

        Args:
            batch: observations (B, ...) of this control step; with a time axis (B, H, ...) they are taken
                for the history itself.
            envs: the environments (n) to predict for; None for all.
            n_samples: how often to repeat them: (n_samples * n, ...).
        """
        history = self._history_of(batch) if self._has_time(batch) else self._history.stack(envs)
        batch = private(_repeated(_selected(batch, self.batch_size(batch), envs), n_samples))
        if self._keys:
            history = _repeated(history, n_samples)
            queues = self._queues
            for key in self._keys:
                queues[key] = deque(history[key].unbind(1), maxlen=queues[key].maxlen)
            batch |= {key: history[key][:, -1] for key in self._keys}
        batch.pop(ACTION, None)
        return batch

    def has_own_history(self, batch: Batch) -> bool:
        """Whether ``batch`` brings the history that the inner policy would look for in its queues."""
        return bool(self._keys) and self._has_time(batch)

    def _has_time(self, batch: Batch) -> bool:
        inputs = self._inner.config.input_features or {}
        return any(key in batch and batch[key].ndim == len(inputs[key].shape) + 2 for key in inputs)

    def _history_of(self, batch: Batch) -> dict[str, Tensor]:
        """The history that ``batch`` brings, up to the current step: tdmpc trains on later ones, too."""
        steps = self._inner.config.observation_delta_indices
        n_steps = None if steps is None else list(steps).index(0) + 1
        return {key: value[:, :n_steps] for key, value in self._queued(batch).items()}

    def _queued(self, batch: Batch) -> dict[str, Tensor]:
        """The observations that are kept in queues; cameras are stacked into one, as LeRobot does."""
        cameras = list(self._inner.config.image_features)
        of_cameras = (OBS_IMAGES, OBS_IMAGE)  # names of queues
        missing = [key for key in (*self._keys, *cameras) if key not in batch and key not in of_cameras]
        if missing:
            raise FeatureError(
                f"the policy needs {', '.join(missing)}, but the batch has only {', '.join(batch)}"
            )
        queued = {key: batch[key] for key in self._keys if key not in of_cameras}
        if OBS_IMAGES in self._keys:
            queued[OBS_IMAGES] = torch.stack([batch[key] for key in cameras], dim=-4)
        if OBS_IMAGE in self._keys:  # tdmpc's, which sees one camera
            queued[OBS_IMAGE] = batch[_tdmpc_camera(cameras)]
        return queued


def _tdmpc_camera(cameras: list[str]) -> str:
    if cameras != [OBS_IMAGE]:
        raise FeatureError(
            f"LeRobot's tdmpc acts on a camera that is called {OBS_IMAGE!r} alone, not on {cameras[0]!r}: "
            f'rename it before training, with --rename_map=\'{{"{cameras[0]}": "{OBS_IMAGE}"}}\''
        )
    return OBS_IMAGE


def private(batch: Batch) -> Batch:
    """A copy that may be written to; some policies of LeRobot do. Images are shared, none writes to them."""
    return {
        key: value.clone() if isinstance(value, Tensor) and value.ndim <= 3 else value
        for key, value in batch.items()
    }


def _selected(batch: Batch, batch_size: int, envs: Environments) -> Batch:
    if envs is None:
        return batch
    return {
        key: _rows(value, envs) if _has_rows(value, batch_size) else value for key, value in batch.items()
    }


def _has_rows(value: Any, batch_size: int) -> bool:
    is_rows = isinstance(value, list | tuple) or (isinstance(value, Tensor) and value.ndim > 0)
    return is_rows and len(value) == batch_size


def _rows(value: Any, envs: Tensor) -> Any:
    return value[envs.to(value.device)] if isinstance(value, Tensor) else [value[i] for i in envs.tolist()]


def _repeated(batch: Batch, n_samples: int) -> Batch:
    if n_samples == 1:
        return batch
    return {key: _repeat(value, n_samples) for key, value in batch.items()}


def _repeat(value: Any, n_samples: int) -> Any:
    if isinstance(value, Tensor) and value.ndim > 0:
        return value.repeat(n_samples, *[1] * (value.ndim - 1))
    return list(value) * n_samples if isinstance(value, list | tuple) else value
