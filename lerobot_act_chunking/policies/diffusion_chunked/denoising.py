"""From observations and noise to chunks: how network, process, sampler and guidance are put together."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from lerobot.configs import RTCAttentionSchedule
from torch import Tensor

from lerobot_act_chunking.data.batch import Observation
from lerobot_act_chunking.execution.plan import Plan
from lerobot_act_chunking.nn.denoisers.denoiser import Context
from lerobot_act_chunking.policies.diffusion_chunked.configuration_diffusion_chunked import (
    DiffusionChunkedConfig,
)
from lerobot_act_chunking.policies.diffusion_chunked.network import DiffusionNetwork
from lerobot_act_chunking.sampling.continuation import (
    Jacobian,
    PrefixSchedule,
    continued,
    held,
    prefix_weights,
)
from lerobot_act_chunking.sampling.guidance import classifier_free
from lerobot_act_chunking.sampling.process import Process
from lerobot_act_chunking.sampling.samplers import Denoise, Sampler
from lerobot_act_chunking.sampling.solvers import Generators

_SCHEDULES: dict[RTCAttentionSchedule, PrefixSchedule] = {
    RTCAttentionSchedule.LINEAR: "linear",
    RTCAttentionSchedule.EXP: "exp",
    RTCAttentionSchedule.ONES: "ones",
    RTCAttentionSchedule.ZEROS: "zeros",
}


@dataclass(frozen=True)
class Guidance:
    """How a plan guides (real-time chunking); see `DiffusionChunkedConfig` for the fields."""

    vjp: Jacobian
    schedule: PrefixSchedule
    max_weight: float

    @classmethod
    def from_config(cls, config: DiffusionChunkedConfig) -> "Guidance":
        """The configured guidance; what ``lerobot-rollout`` asks for wins."""
        rtc = config.rtc_config
        if rtc is None:
            return cls(config.rtc_vjp, config.prefix_attention_schedule, config.max_guidance_weight)
        return cls(config.rtc_vjp, _SCHEDULES[rtc.prefix_attention_schedule], rtc.max_guidance_weight)


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
        generators: Generators = None,
        *,
        prefix: Plan | None = None,
        towards: tuple[Plan, Guidance] | None = None,
    ) -> Float[Tensor, "B T A"]:
        """Denoise one chunk for each row of ``noise``.

        Args:
            window: observations (b, H, ...); B is a multiple of b, sample by sample.
            sampler: its steps.
            noise: where it starts: noise, or partly noised actions.
            generators: for samplers that draw on the way.
            prefix: plan whose frozen actions the network is given.
            towards: plan that the chunk is guided towards.
        """
        denoise = self._network_denoise(window, sampler.times, len(noise), prefix)
        if self.guidance_scale != 1:
            denoise = classifier_free(denoise, self.guidance_scale)
        if towards is not None:
            denoise = self._guided(denoise, sampler.times, *towards)
        return sampler(denoise, noise, generators)

    def edit(
        self,
        window: Observation,
        samplers: tuple[Sampler, Sampler],
        noise: Float[Tensor, "B T A"],
        generators: list[torch.Generator],
        plan: Plan,
    ) -> Float[Tensor, "B T A"]:
        """Noise the plan in part and denoise it again (SDEdit); from pure noise where there is no plan.

        Args:
            window: observations (b, H, ...); B is a multiple of b, sample by sample.
            samplers: one that starts late, from partly noised actions, and one that starts from noise.
            noise: for every row.
            generators: one per row.
            plan: to be edited.
        """
        late, _ = samplers
        planned = plan.covered[:, 0]
        partly_noised = self.process.noised(plan.actions, noise, late.times[0].to(noise))
        start = torch.where(planned[:, None, None], partly_noised, noise)
        chunks = torch.empty_like(noise)
        for sampler, rows in zip(samplers, (planned, ~planned), strict=True):
            these = rows.nonzero()[:, 0].cpu()
            if len(these):
                chosen = window.select(these % window.batch_size)
                own = [generators[i] for i in these]
                chunks[these] = self.sample(chosen, sampler, start[these], own)
        return chunks

    def _network_denoise(
        self, window: Observation, times: Tensor, n_rows: int, prefix: Plan | None
    ) -> Denoise:
        doubled = self.guidance_scale != 1
        context = self._context(window, n_rows, doubled)
        denoiser = self.network.denoiser
        times = times.to(context.modulation.dtype)
        table = denoiser.modulate(times.to(context.modulation))  # for all evaluations at once
        of_x, of_output = (weights.tolist() for weights in self.process.clean_weights(times))

        def denoise(x: Tensor, i: int, modulation: Tensor | None = None) -> Tensor:
            output = denoiser(x, table[i : i + 1] if modulation is None else modulation, context)
            return of_x[i] * x + of_output[i] * output

        if prefix is None:
            return denoise
        given, actions = prefix.frozen.unflatten(1, (-1, denoiser.patch_size)).all(-1), prefix.actions
        if doubled:
            given, actions = torch.cat([given, given]), torch.cat([actions, actions])
        clean = denoiser.modulate(context.modulation.new_tensor([self.process.clean_time]))[:, None]

        def per_token(x: Tensor, i: int) -> Tensor:
            return denoise(x, i, torch.where(given[..., None], clean, table[i : i + 1, None]))

        return held(per_token, actions, given.repeat_interleave(denoiser.patch_size, dim=1))

    def _context(self, window: Observation, n_rows: int, doubled: bool) -> Context:
        condition, denoiser = self.network.condition, self.network.denoiser
        if not doubled:
            context = denoiser.observe(condition(window.vectors, window.images))
            return context.repeat(n_rows // window.batch_size)
        row = torch.arange(2 * n_rows, device=next(self.network.parameters()).device)
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
