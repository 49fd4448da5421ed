"""The `diffusion_chunked` policy: denoising in LeRobot's contract."""

import dataclasses
import math
import warnings
from collections.abc import Sequence
from typing import Any, Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from lerobot_act_chunking.data.batch import ActionTarget, Observation
from lerobot_act_chunking.data.masking import hold_padding, per_sample_error
from lerobot_act_chunking.execution.interpolation import upsample
from lerobot_act_chunking.execution.timeline import Environments
from lerobot_act_chunking.policies.chunked_policy import Batch, ChunkedPolicy, indices, not_finite
from lerobot_act_chunking.policies.diffusion_chunked.configuration_diffusion_chunked import (
    DiffusionChunkedConfig,
)
from lerobot_act_chunking.policies.diffusion_chunked.denoising import Denoising, Guidance
from lerobot_act_chunking.policies.diffusion_chunked.network import DiffusionNetwork, build_network
from lerobot_act_chunking.policies.diffusion_chunked.plan import Plan
from lerobot_act_chunking.policies.diffusion_chunked.training_noise import TrainingNoise
from lerobot_act_chunking.sampling.continuation import covered_steps
from lerobot_act_chunking.sampling.noise import NoiseHold, NoiseSource
from lerobot_act_chunking.sampling.process import Diffusion, Flow, TwoStep
from lerobot_act_chunking.sampling.samplers import Sampler, make_sampler

PROCESSES = {"flow": Flow, "ddpm": Diffusion, "two_step": TwoStep}


class DiffusionChunkedPolicy(ChunkedPolicy[DiffusionChunkedConfig, DiffusionNetwork]):
    """Chunks by diffusion (Chi et al. 2023), flow matching or two-step regression, from any inputs."""

    config_class = DiffusionChunkedConfig  # pyright: ignore[reportAssignmentType]
    name = "diffusion_chunked"  # pyright: ignore[reportAssignmentType]
    _fsdp_wrap_modules = ["MixerBlock", "DitBlock", "ResidualBlock1d"]  # noqa: RUF012

    def _build(self, backbone_weights: str | None) -> DiffusionNetwork:
        self.process = PROCESSES[self.config.objective](**self.config.process_settings)
        self.training_noise = TrainingNoise()
        return build_network(self.config, backbone_weights)

    @property
    def _backbone(self) -> nn.Module | None:
        cameras = self.model.condition.cameras
        return None if cameras is None else cameras.backbone

    def forward(
        self, batch: Batch, reduction: Literal["mean", "none"] = "mean"
    ) -> tuple[Tensor, dict[str, float]]:
        """Training loss: squared error of what the network is asked for, at random noise levels.

        What is drawn follows from the run's seed and the number of batches before; see `TrainingNoise`.

        Args:
            batch: observations, ``action`` (B, horizon, A) and ``action_is_pad`` (B, horizon).
            reduction: ``mean`` for a scalar; ``none`` for one loss per sample (B,), with the same mean.

        Returns:
            The loss, and the same as a plain number.

        Raises:
            FeatureError: naming a key that is missing or has another shape than the policy was built for.
            DatasetError: if the loss is not finite, naming the first key that holds a NaN or an infinity.
        """
        target = ActionTarget.from_lerobot(batch, self.feature_spec, self.config.horizon)
        window = Observation.window_from_lerobot(batch, self.feature_spec, self.config.n_obs_steps)
        actions = hold_padding(target.actions, target.is_pad)
        generator = self.training_noise.generator(actions.device)
        time = self.process.draw_times(len(actions), actions, generator)
        noise = torch.randn(actions.shape, generator=generator, device=actions.device, dtype=actions.dtype)
        prefix, drop = self._draw_prefix(actions, generator), self._draw_drop(actions, generator)
        error = self._error(window, actions, noise, time, prefix, drop)
        ignored = target.is_pad if self.config.do_mask_loss_for_padding else torch.zeros_like(target.is_pad)
        if prefix is not None:
            ignored = ignored | prefix
        loss = per_sample_error(error, ignored, "valid")
        metrics = {"mse_loss": loss.mean().item()}
        if not math.isfinite(metrics["mse_loss"]):
            raise not_finite(batch, metrics)
        return (loss.mean() if reduction == "mean" else loss), metrics

    def _error(
        self,
        window: Observation,
        actions: Float[Tensor, "B T A"],
        noise: Float[Tensor, "B T A"],
        time: Float[Tensor, " B"],
        prefix: Bool[Tensor, "B T"] | None = None,
        drop: Bool[Tensor, " B"] | None = None,
    ) -> Float[Tensor, "B T A"]:
        """Squared error of the network at these noise levels.

        Args:
            window: observations.
            actions: clean.
            noise: mixed into them ...
            time: ... at these times.
            prefix: actions that the network is given.
            drop: samples whose ``guidance_features`` are left out.
        """
        network, token_time = self._network, time
        if prefix is not None:
            time = torch.where(prefix, self.process.clean_time, time[:, None])
            token_time = time[:, :: self.config.actions_per_token]
        x = self.process.noised(actions, noise, time)
        context = network.denoiser.observe(network.condition(window.vectors, window.images, drop))
        output = network.denoiser(x, network.denoiser.modulate(token_time), context)
        return (output - self.process.target(actions, noise, time)).square()

    def _draw_prefix(
        self, actions: Float[Tensor, "B T A"], generator: torch.Generator
    ) -> Bool[Tensor, "B T"] | None:
        """Which first actions are given: as many tokens as chance says, up to `prefix_tokens`."""
        if not self.config.prefix_steps:
            return None
        device, longest = actions.device, self.config.prefix_tokens
        n_tokens = torch.randint(longest + 1, (len(actions), 1), generator=generator, device=device)
        steps = torch.arange(actions.shape[1], device=device)
        return steps < n_tokens * self.config.actions_per_token

    def _draw_drop(
        self, actions: Float[Tensor, "B T A"], generator: torch.Generator
    ) -> Bool[Tensor, " B"] | None:
        """For which samples the ``guidance_features`` are left out."""
        if not (self.training and self.config.condition_dropout):
            return None
        drawn = torch.rand(len(actions), generator=generator, device=actions.device)
        return drawn < self.config.condition_dropout

    @torch.no_grad()
    def predict_action_chunk(
        self,
        batch: Batch,
        noise: Float[Tensor, "B T A"] | None = None,
        inference_delay: int | None = None,
        prev_chunk_left_over: Float[Tensor, "*B P A"] | None = None,
        execution_horizon: int | None = None,
        **_: Any,
    ) -> Tensor:
        """The whole chunk of normalised actions (B, T, A) from the current step on, one per control step.

        Observations with a time axis (B, n_obs_steps, ...) are used as they are; others are added to those
        of earlier calls, as in `select_action`: use one or the other in a rollout.

        Args:
            batch: observations.
            noise: (B, horizon, A) to start from; by default the environments' generators draw it.
            inference_delay: control steps that computing the chunk will take (real-time chunking).
            prev_chunk_left_over: what is left of the chunk in execution, normalised, from the current step
                on; zeros behind its end do not count. The new chunk continues it: as trained with
                ``warm_start=prefix``, else by guidance.
            execution_horizon: control steps of the left-over to continue; all by default.
        """
        self.eval()
        window = self._window_of(batch)
        plan = self._left_over(prev_chunk_left_over, inference_delay or 0, execution_horizon)
        start = "prefix" if self.config.warm_start == "prefix" else "rtc"
        keyframes = self._sample(window, None, 1, noise=noise, plan=plan, start=start)[0]
        return self._control_steps(keyframes, self.config.timing.control_steps)

    @torch.no_grad()
    def predict_samples(
        self,
        batch: Batch,
        n_samples: int,
        *,
        noise: Float[Tensor, "N B T A"] | None = None,
        sampler: str | None = None,
        num_inference_steps: int | None = None,
        timestep_spacing: str | None = None,
    ) -> Float[Tensor, "N B K A"]:
        """Several chunks for each observation, from now on at every control step; other samplers at will.

        Args:
            batch: observations, as for `predict_action_chunk`.
            n_samples: N, chunks per observation.
            noise: (N, B, horizon, A) to start from; by default the environments' generators draw it.
            sampler: in place of the configured one, and likewise ``num_inference_steps`` and
                ``timestep_spacing``.

        Raises:
            ConfigurationError: the sampler does not fit the policy.
        """
        self.eval()
        chosen = self._sampler(sampler, num_inference_steps, timestep_spacing)
        window = self._window_of(batch)
        keyframes = self._sample(window, None, n_samples, noise=noise, sampler=chosen)
        chunks = self._control_steps(keyframes.flatten(0, 1), self.config.timing.control_steps)
        return chunks.unflatten(0, keyframes.shape[:2])

    def _predict(self, window: Observation, envs: Environments, n_steps: int) -> Tensor:
        settings = self._action_queue.settings
        n_samples = settings.n_samples or 1
        plan = self._current_plan(envs, settings.latency_steps)
        keyframes = self._sample(window, envs, n_samples, plan=plan, start=self.config.warm_start)
        chunks = self._control_steps(keyframes.flatten(0, 1), n_steps)
        return chunks if settings.n_samples is None else chunks.unflatten(0, (n_samples, -1))

    def _control_steps(self, predictions: Float[Tensor, "n T A"], n_steps: int) -> Float[Tensor, "n K A"]:
        """The first ``n_steps`` from now on, interpolated between predictions."""
        config = self.config
        needed = predictions[:, config.timing.past_steps :][:, : config.timing.predictions_for(n_steps)]
        return upsample(needed, config.chunk_stride, config.gripper_dims)[:, :n_steps]

    def _current_plan(self, envs: Environments, delay: int) -> Plan | None:
        if self.config.warm_start in ("none", "noise_hold"):
            return None
        steps, covered = self._action_queue.plan(envs)
        return self._plan(steps, covered, delay) if steps.numel() else None

    def _left_over(self, steps: Tensor | None, delay: int, execution_horizon: int | None) -> Plan | None:
        rtc = self.config.rtc_config
        if steps is None or not steps.numel() or (rtc is not None and not rtc.enabled):
            return None
        steps = steps if steps.ndim == 3 else steps[None]
        return self._plan(steps[:, :execution_horizon], covered_steps(steps[:, :execution_horizon]), delay)

    def _plan(self, steps: Float[Tensor, "n P A"], covered: Bool[Tensor, "r P"], delay: int) -> Plan | None:
        return Plan.from_steps(
            steps, covered, horizon=self.config.horizon, chunk_stride=self.config.chunk_stride, delay=delay
        )

    def _sample(
        self,
        window: Observation,
        envs: Environments,
        n_samples: int,
        *,
        noise: Tensor | None = None,
        plan: Plan | None = None,
        start: str = "none",
        sampler: Sampler | None = None,
    ) -> Float[Tensor, "N n T A"]:
        """Chunks at the predicted steps, for the environments ``envs`` (None: all) of ``window``."""
        n_envs = window.batch_size
        noise = self._noise_for(envs, n_envs, n_samples) if noise is None else noise.flatten(0, -3)
        noise = noise.to(self._example)
        generators = self._noise.generators(n_envs, envs, n_samples)
        plan = None if plan is None else plan.repeat(n_samples)
        sampler = sampler or self._sampler()
        denoising = Denoising(self._network, self.process, self.config.guidance_scale)
        if plan is None or start == "none":
            chunks = denoising.sample(window, sampler, noise, generators)
        elif start == "sdedit":
            chunks = self._edit(denoising, window, noise, generators, plan)
        elif start == "prefix":
            chunks = denoising.sample(window, sampler, noise, generators, prefix=self._as_trained(plan))
        else:
            towards = (plan, Guidance.from_config(self.config))
            chunks = denoising.sample(window, sampler, noise, generators, towards=towards)
        return chunks.unflatten(0, (n_samples, n_envs))

    def _edit(
        self,
        denoising: Denoising,
        window: Observation,
        noise: Float[Tensor, "B T A"],
        generators: list[torch.Generator],
        plan: Plan,
    ) -> Float[Tensor, "B T A"]:
        """Noise the plan in part and denoise it again; from pure noise where there is no plan."""
        fresh = self._sampler()
        late = self._sampler(strength=self.config.sdedit_strength)
        planned = plan.covered[:, 0]
        if planned.all():
            return denoising.sample(
                window, late, self.process.noised(plan.actions, noise, late.times[0]), generators
            )
        rows = [planned.nonzero()[:, 0].cpu(), (~planned).nonzero()[:, 0].cpu()]
        chunks = torch.empty_like(noise)
        for these, sampler in zip(rows, (late, fresh), strict=True):
            if sampler is late:
                start = self.process.noised(plan.actions[these], noise[these], late.times[0])
            else:
                start = noise[these]
            chosen = window.select(these % window.batch_size)
            chunks[these] = denoising.sample(chosen, sampler, start, [generators[i] for i in these])
        return chunks

    def _as_trained(self, plan: Plan) -> Plan:
        """A plan whose frozen actions fill whole tokens, at most as many as training has shown."""
        per_token = self.config.actions_per_token
        n_tokens = math.ceil(plan.n_frozen / per_token)
        if n_tokens > self.config.prefix_tokens:
            warnings.warn(
                f"the chunk takes longer than prefix_steps={self.config.prefix_steps} control steps to "
                "compute: it is conditioned on no more than that",
                stacklevel=2,
            )
        return dataclasses.replace(plan, n_frozen=min(n_tokens, self.config.prefix_tokens) * per_token)

    def _sampler(
        self,
        name: str | None = None,
        num_inference_steps: int | None = None,
        timestep_spacing: str | None = None,
        *,
        strength: float = 1.0,
    ) -> Sampler:
        config = self.config
        other = name is not None and name != config.sampler
        name, n_steps = name or config.sampler, num_inference_steps or config.num_inference_steps
        asked = {
            "spacing": timestep_spacing or (None if other else config.timestep_spacing),
            "strength": strength,
            "clip": config.clip_sample_range if config.clip_sample else None,
            "clip_mode": config.clip_mode if name in ("ddim", "ddpm") else "consistent",
        }
        key = (name, n_steps, *asked.values())
        if key not in self._samplers:
            self._samplers[key] = make_sampler(self.process, name, n_steps, **asked)
        return self._samplers[key]

    def _noise_for(self, envs: Environments, n_envs: int, n_samples: int) -> Float[Tensor, "B T A"]:
        shape = (self.config.horizon, *self.feature_spec.action)
        if self.config.warm_start != "noise_hold":
            return self._noise.draw(n_envs, shape, envs=envs, n_samples=n_samples)
        first = self._action_queue.n_steps // self.config.chunk_stride
        return self._held_noise.draw(n_envs, shape, first, envs=envs)

    @property
    def _example(self) -> Tensor:
        """A weight, for its device and precision."""
        return next(self.model.parameters())

    def reset(self, envs: Sequence[int] | Tensor | None = None) -> None:
        """Forget observations and chunks and begin the noise anew: a new rollout, everywhere or in these."""
        super().reset(envs)
        if envs is None:
            self._noise = NoiseSource(self.config.noise_seed)
            self._held_noise = NoiseHold(self._noise)
            self._samplers: dict[tuple[Any, ...], Sampler] = {}
        else:
            self._noise.reset(indices(envs).tolist())
            self._held_noise.reset(indices(envs).tolist())

    def supports_rtc(self) -> bool:
        """Real-time chunking works: `predict_action_chunk` continues the chunk in execution."""
        return self.config.timing.past_steps == 0 and self.config.objective != "two_step"

    def _get_default_peft_targets(self) -> dict[str, Any]:
        """Adapt all linear layers of the denoiser."""
        return {"target_modules": r"model\.denoiser\..*(proj|expand|contract|film|modulation)"}
