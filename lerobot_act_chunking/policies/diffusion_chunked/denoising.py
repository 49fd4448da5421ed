"""From observations and noise to chunks: how network, process, sampler and guidance are put together."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from lerobot_act_chunking.data.batch import Observation
from lerobot_act_chunking.nn.denoisers.denoiser import Context
from lerobot_act_chunking.policies.diffusion_chunked.configuration_diffusion_chunked import (
    DiffusionChunkedConfig,
)
from lerobot_act_chunking.policies.diffusion_chunked.network import DiffusionNetwork
from lerobot_act_chunking.policies.diffusion_chunked.plan import Plan
from lerobot_act_chunking.sampling.continuation import continued, held, prefix_weights
from lerobot_act_chunking.sampling.guidance import classifier_free
from lerobot_act_chunking.sampling.process import Process
from lerobot_act_chunking.sampling.samplers import Denoise, Sampler


@dataclass(frozen=True)
class Guidance:
    """How a plan guides (real-time chunking); see `DiffusionChunkedConfig` for the fields."""

    vjp: str
    schedule: str
    max_weight: float

    @classmethod
    def from_config(cls, config: DiffusionChunkedConfig) -> "Guidance":
        """The configured guidance; what ``lerobot-rollout`` asks for wins."""
        rtc = config.rtc_config
        if rtc is None:
            return cls(config.rtc_vjp, config.prefix_attention_schedule, config.max_guidance_weight)
        return cls(config.rtc_vjp, rtc.prefix_attention_schedule.value.lower(), rtc.max_guidance_weight)


@dataclass(frozen=True)
class Denoising:
    """A network with the process that it was trained on.

    Attributes:
        network: observation and denoiser.
        process: how noise was mixed into actions.
        guidance_scale: of the features that guidance may leave out; 1 is off.
    """

    network: DiffusionNetwork
    process: Process
    guidance_scale: float

    def sample(
        self,
        window: Observation,
        sampler: Sampler,
        noise: Float[Tensor, "B T A"],
        generators: list[torch.Generator] | None = None,
        *,
        prefix: Plan | None = None,
        towards: tuple[Plan, Guidance] | None = None,
    ) -> Float[Tensor, "B T A"]:
        """Denoise one chunk for each row of ``noise``.

        Args:
            window: observations (b, H, ...); B is a multiple of b, sample by sample.
            sampler: its steps.
            noise: where it starts: noise, or partly noised actions.
            generators: one per row, for samplers that draw on the way.
            prefix: plan whose frozen actions the network is given.
            towards: plan that the chunk is guided towards.
        """
        denoise = self._network_denoise(window, sampler.times, len(noise), prefix)
        if self.guidance_scale != 1:
            denoise = classifier_free(denoise, self.guidance_scale)
        if towards is not None:
            denoise = self._guided(denoise, sampler.times, *towards)
        return sampler(denoise, noise, generators)

    def _network_denoise(
        self, window: Observation, times: Tensor, n_rows: int, prefix: Plan | None
    ) -> Denoise:
        doubled = self.guidance_scale != 1
        context = self._context(window, n_rows, doubled)
        denoiser, process = self.network.denoiser, self.process
        times = times.to(context.modulation)
        table = denoiser.modulate(times)
        given = None if prefix is None else _doubled(prefix.frozen, doubled)
        if given is not None:
            given = given.unflatten(1, (-1, denoiser.patch_size)).all(-1)  # tokens
        clean_row = None if prefix is None else denoiser.modulate(times.new_full((1,), process.clean_time))
        of_x, of_output = (weights.tolist() for weights in process.clean_weights(times))

        def denoise(x: Tensor, i: int) -> Tensor:
            modulation = table[i : i + 1]
            if given is not None:
                modulation = torch.where(given[..., None], clean_row[:, None], modulation[:, None])
            output = denoiser(x, modulation, context)
            return of_x[i] * x + of_output[i] * output

        if prefix is None or given is None:
            return denoise
        frozen = given.repeat_interleave(denoiser.patch_size, dim=1)
        return held(denoise, _doubled(prefix.actions, doubled), frozen)

    def _context(self, window: Observation, n_rows: int, doubled: bool) -> Context:
        condition, denoiser = self.network.condition, self.network.denoiser
        if not doubled:
            context = denoiser.observe(condition(window.vectors, window.images))
            return context.repeat(n_rows // window.batch_size)
        row = torch.arange(2 * n_rows)
        window, drop = window.select(row % window.batch_size), row >= n_rows
        return denoiser.observe(condition(window.vectors, window.images, drop))

    def _guided(self, denoise: Denoise, times: Tensor, plan: Plan, guidance: Guidance) -> Denoise:
        alphas, sigmas = self.process.levels(times)
        horizon = plan.covered.shape[1]
        ends = plan.covered.sum(1)
        rows = {
            end: prefix_weights(plan.n_frozen, end, horizon, guidance.schedule) for end in set(ends.tolist())
        }
        weights = torch.stack([rows[end] for end in ends.tolist()]).to(plan.actions)
        return continued(
            denoise, alphas, sigmas, plan.actions, weights, vjp=guidance.vjp, max_weight=guidance.max_weight
        )


def _doubled[TensorT: Bool[Tensor, "..."] | Float[Tensor, "..."]](rows: TensorT, doubled: bool) -> TensorT:
    return torch.cat([rows, rows]) if doubled else rows
