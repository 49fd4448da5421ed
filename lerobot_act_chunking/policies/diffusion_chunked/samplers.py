"""The samplers that a configuration asks for, made once."""

from lerobot_act_chunking.policies.diffusion_chunked.configuration_diffusion_chunked import (
    DiffusionChunkedConfig,
)
from lerobot_act_chunking.sampling.process import PROCESSES, Process
from lerobot_act_chunking.sampling.samplers import Sampler, make_sampler


def make_process(config: DiffusionChunkedConfig) -> Process:
    """How noise is mixed into actions."""
    return PROCESSES[config.objective](**config.process_settings)


class ConfiguredSamplers:
    """Samplers of one process, kept: each is a table."""

    def __init__(self, config: DiffusionChunkedConfig, process: Process):
        self.config = config
        self.process = process
        self._made: dict[tuple[object, ...], Sampler] = {}

    def get(
        self,
        name: str | None = None,
        num_inference_steps: int | None = None,
        timestep_spacing: str | None = None,
        *,
        strength: float = 1.0,
    ) -> Sampler:
        """The configured sampler, but for what is given here; see `make_sampler`.

        Raises:
            ConfigurationError: it does not fit the process.
        """
        config = self.config
        if timestep_spacing is None and name in (None, config.sampler):
            timestep_spacing = config.timestep_spacing
        name, n_steps = name or config.sampler, num_inference_steps or config.num_inference_steps
        options = {
            "spacing": timestep_spacing,
            "strength": strength,
            "clip": config.clip_sample_range if config.clip_sample else None,
            "clip_mode": config.clip_mode if name in ("ddim", "ddpm") else "consistent",
        }
        key = (name, n_steps, *options.values())
        if key not in self._made:
            self._made[key] = make_sampler(self.process, name, n_steps, **options)
        return self._made[key]
