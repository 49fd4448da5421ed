"""Chunks as the policy samples them at the starts of episodes."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float

from lerobot_act_chunking.diagnostics.core.rollouts import Rollout
from lerobot_act_chunking.diagnostics.core.samples import Samples
from lerobot_act_chunking.policies.loading import LoadedPolicy


@torch.no_grad()
def sample_chunks(loaded: LoadedPolicy, starts: Samples, n_samples: int) -> Float[np.ndarray, "N S T A"]:
    """Chunks in the environment's units; one for each start if all samples of it are the same.

    Args:
        loaded: a policy that has ``predict_samples``.
        starts: observations.
        n_samples: S.
    """
    parts = []
    for raw in starts.batches():
        batch = loaded.preprocessor(raw)
        loaded.policy.reset()
        chunks = loaded.policy.predict_samples(batch, n_samples)  # pyright: ignore[reportCallIssue]
        actions = loaded.postprocessor(chunks.flatten(0, 2)).cpu().unflatten(0, chunks.shape[:3])
        parts.append(actions.transpose(0, 1))
    found = torch.cat(parts).double().numpy()
    return found[:, :1] if is_deterministic(found) else found


def is_deterministic(chunks: Float[np.ndarray, "N S T A"]) -> bool:
    """Whether all samples at each start are the same, but for rounding."""
    return bool(np.ptp(chunks, axis=1).max() <= 1e-4 * max(np.abs(chunks).max(), 1e-9))


def first_chunks(rollouts: Sequence[Rollout]) -> Float[np.ndarray, "N 1 T A"] | None:
    """The chunk of each episode's first step, of policies that cannot be asked for samples; None of none."""
    found = [each.inferences[0].chunk for each in rollouts if each.inferences]
    return np.stack(found)[:, None].astype(np.float64) if found else None
