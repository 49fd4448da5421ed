"""A policy with its preprocessor as one module: raw observations and random numbers in, chunks out."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from act_chunking_runtime.files import InputSpec
from lerobot_act_chunking.data.batch import Observation
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.exporting.acting import Acting

STEPS = ("RenameObservations", "AddBatchDimension", "Device", "Normalizer")
"""Processors that do nothing to a tensor that a graph could not."""


class ExportedNetwork(nn.Module):
    """What a graph is made of.

    It takes the observations (1, H, ...) by `inputs`, images as uint8 (1, H, height, width, 3), and then the
    random numbers by ``acting.draws``.

    Args:
        policy: whose chunks they are.
        preprocessor: normalises observations.
        acting: how the policy acts.

    Raises:
        ConfigurationError: the preprocessor does more than to rename and normalise.
    """

    def __init__(self, policy: Any, preprocessor: Any, acting: Acting):
        super().__init__()
        unknown = [name for step in preprocessor.steps if not (name := type(step).__name__).startswith(STEPS)]
        if unknown:
            raise ConfigurationError(
                f"this checkpoint's preprocessor has the step {unknown[0]}, which cannot be exported; what "
                "can be: renaming and normalising"
            )
        self.policy = policy
        self.spec = policy.feature_spec
        self.preprocessor = preprocessor
        self.acting = acting
        renamed = {new: old for step in preprocessor.steps for old, new in _renaming(step).items()}
        keys: list[str] = [*self.spec.vectors, *self.spec.images]
        self.names = {key: renamed.get(key, key) for key in keys}

    @property
    def inputs(self) -> dict[str, InputSpec]:
        """What a robot gives, by the names before any renaming."""
        vectors = {self.names[key]: InputSpec(shape, "float32") for key, shape in self.spec.vectors.items()}
        images = {
            self.names[key]: InputSpec((height, width, channels), "uint8")
            for key, (channels, height, width) in self.spec.images.items()
        }
        return vectors | images

    def examples(self) -> dict[str, Tensor]:
        """Something for each input, by its name."""
        generator = torch.Generator().manual_seed(0)
        steps = (1, self.policy.config.n_obs_steps)
        given = {
            key: torch.rand(*steps, *spec.shape, generator=generator)
            if spec.dtype == "float32"
            else torch.randint(256, (*steps, *spec.shape), generator=generator, dtype=torch.uint8)
            for key, spec in self.inputs.items()
        }
        drawn = {each.name: torch.rand(*each.shape, generator=generator) for each in self.acting.draws}
        return given | drawn

    def forward(self, *inputs: Tensor) -> Float[Tensor, "N 1 T A"]:
        """Normalised chunks."""
        n_inputs = len(self.names)
        drawn = dict(zip((each.name for each in self.acting.draws), inputs[n_inputs:], strict=True))
        batch = {
            name: (value.movedim(-1, -3).float() / 255 if key in self.spec.images else value)
            for (key, name), value in zip(self.names.items(), inputs[:n_inputs], strict=True)
        }
        steps = self.policy.config.n_obs_steps
        window = Observation.window_from_lerobot(self.preprocessor(batch), self.spec, steps)
        return self.acting.chunks(window, drawn)


def _renaming(step: Any) -> dict[str, str]:
    return getattr(step, "rename_map", None) or {}
