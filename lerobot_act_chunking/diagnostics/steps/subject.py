"""A `diffusion_chunked` checkpoint as what the sweep samples from."""

from collections.abc import Mapping
from dataclasses import dataclass
from statistics import median
from time import perf_counter
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.diagnostics.steps.grid import Cell
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.loading import LoadedPolicy, load_policy

POLICY_TYPE = "diffusion_chunked"
CHUNKS_AT_ONCE = 512
TIMINGS = 5


@dataclass(frozen=True)
class PolicySubject:
    """A policy with held-out observations.

    Attributes:
        policy: with its processors.
        observations: normalised, on the policy's device, (M, n_obs_steps, ...).
        n_steps: control steps of each chunk that are executed.
    """

    policy: LoadedPolicy
    observations: dict[str, Tensor]
    n_steps: int

    @classmethod
    def observing(cls, policy: LoadedPolicy, observations: Mapping[str, Any], n_steps: int) -> Self:
        """The policy with raw observations (M, n_obs_steps, ...) of a dataset."""
        batch = policy.preprocessor(dict(observations))
        kept = {key: value for key, value in batch.items() if key.startswith("observation.")}
        return cls(policy, {key: value for key, value in kept.items() if isinstance(value, Tensor)}, n_steps)

    @property
    def noise_shape(self) -> tuple[int, int]:
        """Of the noise of one chunk, (horizon, A)."""
        config = self.policy.policy.config
        return config.horizon, config.action_feature.shape[0]

    def sample(self, cell: Cell, rows: np.ndarray, noise: Tensor) -> np.ndarray:
        """Executed actions (N, b, T, A) in raw units, a limited number of chunks at once."""
        at_once = max(1, CHUNKS_AT_ONCE // len(noise))
        parts = [
            self._in_raw_units(self._predict(cell, rows[first : first + at_once], part))
            for first, part in zip(range(0, len(rows), at_once), noise.split(at_once, dim=1), strict=True)
        ]
        return np.concatenate(parts, axis=1)

    def milliseconds(self, cell: Cell) -> float:
        """Median time for one chunk of one observation, without processors."""
        row, noise = np.zeros(1, int), torch.zeros(1, 1, *self.noise_shape)
        times = []
        for _ in range(TIMINGS + 1):
            start = perf_counter()
            self._predict(cell, row, noise).to("cpu")
            times.append(1000 * (perf_counter() - start))
        return median(times[1:])

    def _predict(self, cell: Cell, rows: np.ndarray, noise: Tensor) -> Tensor:
        index = torch.from_numpy(rows)
        batch = {key: value[index.to(value.device)] for key, value in self.observations.items()}
        return self.policy.policy.predict_samples(
            batch,
            len(noise),
            noise=noise,
            sampler=cell.sampler,
            num_inference_steps=cell.n_steps,
            timestep_spacing=cell.spacing,
        )

    def _in_raw_units(self, chunks: Tensor) -> np.ndarray:
        """Through the postprocessor, which is made for single actions (n, A)."""
        executed = chunks[:, :, : self.n_steps]
        return self.policy.postprocessor(executed.flatten(0, 2)).to("cpu").numpy().reshape(executed.shape)


def load_steppable(checkpoint: str) -> LoadedPolicy:
    """Load a checkpoint whose steps can be swept.

    Raises:
        ConfigurationError: no such checkpoint, or another type of policy.
    """
    from lerobot_act_chunking.policies.loading import read_config

    config = read_config(checkpoint)
    if config.type == "temporal_ensemble":
        raise ConfigurationError(
            "a temporal_ensemble takes no steps of its own: give the checkpoint it wraps"
        )
    if config.type != POLICY_TYPE:
        raise ConfigurationError(
            f"{config.type} has no denoising steps to sweep: give a {POLICY_TYPE} checkpoint "
            "(objective flow or ddpm)"
        )
    return load_policy(checkpoint)


def own_cell(config: Any) -> Cell:
    """The sampler that a policy is configured for."""
    return Cell(config.sampler, config.num_inference_steps, config.timestep_spacing)


def executed_steps(settings: ExecutionSettings) -> int:
    """How many of a chunk's first control steps reach the robot, given how chunks are executed."""
    if settings.execution in ("ensemble", "adaptive"):
        return settings.n_action_steps
    until = settings.latency_steps + settings.replan_interval + (settings.crossfade_steps or 0)
    return min(settings.n_action_steps, until)
