"""What a policy's latent makes of demonstrations, and what the decoder makes of styles."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from lerobot.utils.constants import OBS_STATE
from torch import Tensor

from lerobot_act_chunking.data.batch import ActionTarget, Observation
from lerobot_act_chunking.data.masking import hold_padding
from lerobot_act_chunking.diagnostics.core.latents.subject import Subject
from lerobot_act_chunking.diagnostics.core.samples import Samples
from lerobot_act_chunking.execution.interpolation import upsample
from lerobot_act_chunking.policies.act_chunked.network import TrainingBatch


@dataclass(frozen=True)
class Encoded:
    """Demonstrations in the latent space.

    Attributes:
        mean: (N, L) of the posteriors.
        divergence: (N, J) from the prior that was trained [nats].
        z: (N, L) a sample of each posterior.
        prior: (N, L) samples of the prior as the policy has it, for the same observations.
        mode: (N, L) its mode.
    """

    mean: Float[np.ndarray, "N L"]
    divergence: Float[np.ndarray, "N J"]
    z: Float[np.ndarray, "N L"]
    prior: Float[np.ndarray, "N L"]
    mode: Float[np.ndarray, "N L"]


@torch.no_grad()
def encode(subject: Subject, samples: Samples, *, seed: int) -> Encoded:
    """Posteriors of demonstrations, and the prior's samples in the same situations."""
    network, latent = subject.network, subject.latent
    generator = torch.Generator().manual_seed(seed)
    parts: list[tuple[Tensor, ...]] = []
    for training_batch in _training_batches(subject, samples):
        tokens = training_batch.observation.tokens
        noise = torch.randn(2, len(tokens), latent.n_noise, generator=generator).to(tokens)
        posterior = network.posterior(training_batch, noise[0])
        styles = posterior.z, latent.prior(noise[1], tokens), latent.prior(None, tokens)
        parts.append((posterior.mean, posterior.divergence, *styles))
    return Encoded(*(torch.cat(each).double().cpu().numpy() for each in zip(*parts, strict=True)))


@dataclass(frozen=True)
class Reconstruction:
    """What decoding makes of demonstrations, in normalised units.

    Attributes:
        errors: (N,) mean absolute error of each chunk, by where its style is from.
        baseline: mean absolute error of the demonstrations' mean action, for which it takes no policy.
    """

    errors: dict[str, Float[np.ndarray, " N"]]
    baseline: float


@torch.no_grad()
def reconstruct(
    subject: Subject, samples: Samples, styles: Mapping[str, Float[np.ndarray, "N L"]], *, seed: int
) -> Reconstruction:
    """Decode chunks from these styles.

    Actions behind the episode's end do not count. A head that samples does so with the same numbers for all.
    """
    errors: dict[str, list[Tensor]] = {name: [] for name in styles}
    demonstrated: list[Tensor] = []
    for target, actions in _acted(subject, samples, styles, seed):
        for name, of_style in actions.items():
            errors[name].append(_absolute_error(of_style, target))
        demonstrated.append(target.actions[~target.is_pad])
    actions = torch.cat(demonstrated).double()
    return Reconstruction(
        {name: torch.cat(parts).double().cpu().numpy() for name, parts in errors.items()},
        float((actions - actions.mean(0)).abs().mean()),
    )


@torch.no_grad()
def decode(
    subject: Subject, samples: Samples, styles: Mapping[str, Float[np.ndarray, "N L"]], *, seed: int
) -> dict[str, Float[np.ndarray, "N T A"]]:
    """Chunks in these styles, in the environment's units, an action for every control step."""
    chunks: dict[str, list[Tensor]] = {name: [] for name in styles}
    config = subject.config
    for _, actions in _acted(subject, samples, styles, seed):
        for name, each in actions.items():
            steps = upsample(each, config.chunk_stride, config.gripper_dims)
            raw = subject.loaded.postprocessor(steps.flatten(0, 1))
            chunks[name].append(raw.cpu().unflatten(0, steps.shape[:2]))
    return {name: torch.cat(parts).double().numpy() for name, parts in chunks.items()}


def _acted(
    subject: Subject, samples: Samples, styles: Mapping[str, Float[np.ndarray, "N L"]], seed: int
) -> Iterator[tuple[ActionTarget, dict[str, Tensor]]]:
    """Demonstrated actions, and those decoded from each style, batch by batch."""
    network, config = subject.network, subject.config
    n_queries = config.chunk_size // config.actions_per_query
    generator = torch.Generator().manual_seed(seed)
    done = 0
    for training_batch in _training_batches(subject, samples):
        size = len(training_batch.observation.tokens)
        shape = network.head.draws_shape
        draws = (
            torch.rand(size, *shape, generator=generator).to(training_batch.observation.tokens)
            if shape
            else None
        )
        actions = {}
        for name, values in styles.items():
            z = torch.from_numpy(values[done : done + size]).to(training_batch.observation.tokens)
            actions[name] = network.act(training_batch.observation, z, draws, n_queries)
        yield training_batch.target, actions
        done += size


def _absolute_error(actions: Float[Tensor, "B T A"], target: ActionTarget) -> Float[Tensor, " B"]:
    valid = ~target.is_pad
    by_step = (actions - target.actions).abs().mean(-1)
    return (by_step * valid).sum(1) / valid.sum(1)


def _training_batches(subject: Subject, samples: Samples) -> Iterator[TrainingBatch]:
    for raw in samples.batches():
        yield _training_batch(subject, subject.loaded.preprocessor(raw))


def _training_batch(subject: Subject, batch: Mapping[str, Any]) -> TrainingBatch:
    config = subject.config
    target = ActionTarget.from_lerobot(batch, config.feature_spec, config.action_delta_indices)
    window = Observation.window_from_lerobot(batch, config.feature_spec, config.n_obs_steps, target)
    actions = hold_padding(target.actions, target.is_pad)
    state = window.vectors.get(OBS_STATE)
    return TrainingBatch(
        observation=subject.network.encode_observation(window),
        state=None if state is None else state[:, -1],
        target=ActionTarget(actions, target.is_pad),
        ignored=target.is_pad,
        decoder_inputs=actions,
        decoder_input_mask=None,
    )
