"""The `diffusion_chunked` policy: denoising in LeRobot's contract."""

from collections.abc import Callable
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from lerobot_act_chunking.compat import check_rtc_mode
from lerobot_act_chunking.data.batch import ActionTarget, Observation
from lerobot_act_chunking.data.masking import hold_padding, per_sample_error
from lerobot_act_chunking.execution.environments import Environments
from lerobot_act_chunking.execution.plan import Plan
from lerobot_act_chunking.nn.denoisers.make import DENOISERS
from lerobot_act_chunking.policies.acting import acting
from lerobot_act_chunking.policies.chunked_policy import Batch, ChunkedPolicy
from lerobot_act_chunking.policies.diffusion_chunked.configuration_diffusion_chunked import (
    DiffusionChunkedConfig,
)
from lerobot_act_chunking.policies.diffusion_chunked.denoising import Denoising, Guidance
from lerobot_act_chunking.policies.diffusion_chunked.network import DiffusionNetwork, build_network
from lerobot_act_chunking.policies.diffusion_chunked.samplers import ConfiguredSamplers, make_process
from lerobot_act_chunking.policies.diffusion_chunked.training_noise import Draws, TrainingNoise
from lerobot_act_chunking.policies.finite_loss import finite_terms
from lerobot_act_chunking.sampling.noise import NoiseHold, NoiseSource
from lerobot_act_chunking.sampling.samplers import Sampler


class DiffusionChunkedPolicy(ChunkedPolicy[DiffusionChunkedConfig, DiffusionNetwork]):
    """Chunks by diffusion (Chi et al. 2023), flow matching or two-step regression, from any inputs."""

    config_class = DiffusionChunkedConfig  # pyright: ignore[reportAssignmentType]
    name = "diffusion_chunked"  # pyright: ignore[reportAssignmentType]
    # A DitBlock lends its layers to what comes before it, so it cannot be sharded alone.
    _fsdp_wrap_modules = ["MixerBlock", "ResidualBlock1d"]  # noqa: RUF012

    def __init__(self, config: DiffusionChunkedConfig, **kwargs: Any):  # LeRobot asks for this annotation
        super().__init__(config, **kwargs)

    def _build(self, backbone_weights: str | None) -> DiffusionNetwork:
        self.process = make_process(self.config)
        self.training_noise = TrainingNoise(self.config, self.process)
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
        target = ActionTarget.from_lerobot(batch, self.feature_spec, self.config.action_delta_indices)
        window = self._training_window(batch, target)
        actions = hold_padding(target.actions, target.is_pad)
        draws = self.training_noise(actions)
        error = self._error(window, actions, draws)
        ignored = target.is_pad if self.config.do_mask_loss_for_padding else torch.zeros_like(target.is_pad)
        if draws.prefix is not None:
            ignored = ignored | draws.prefix
        loss = per_sample_error(error, ignored, "valid")
        metrics = finite_terms(loss, {"mse_loss": loss.mean()}, batch, self.feature_spec.keys)
        loss = self._balanced(loss, batch)
        return (loss.mean() if reduction == "mean" else loss), metrics

    def _error(
        self, window: Observation, actions: Float[Tensor, "B T A"], draws: Draws
    ) -> Float[Tensor, "B T A"]:
        """Squared error of the network at the drawn noise levels, padding and given actions included."""
        network, time, token_time = self._network, draws.time, draws.time
        if draws.prefix is not None:
            time = torch.where(draws.prefix, self.process.clean_time, time[:, None])
            token_time = time[:, :: self.config.actions_per_token]
        x = self.process.noised(actions, draws.noise, time)
        context = network.denoiser.observe(network.condition(window.vectors, window.images, draws.drop))
        output = network.denoiser(x, network.denoiser.modulate(token_time), context)
        return (output - self.process.target(actions, draws.noise, time)).square()

    @acting
    def predict_action_chunk(
        self,
        batch: Batch,
        noise: Float[Tensor, "B T A"] | None = None,
        inference_delay: int | None = None,
        prev_chunk_left_over: Float[Tensor, "*B P A"] | None = None,
        execution_horizon: int | None = None,
        envs: Environments = None,
        **_: Any,
    ) -> Tensor:
        """The whole chunk of normalised actions (B, T, A) from the current step on, one per control step.

        Observations with a time axis (B, n_obs_steps, ...) are used as they are. Others are added to those of
        earlier calls, as in `select_action`: use one or the other in a rollout. With ``inference_delay`` they
        stand for a whole history: real-time engines show one only when they want a chunk.

        Args:
            batch: observations.
            noise: (B, horizon, A) to start from; by default the environments' generators draw it.
            inference_delay: control steps that computing the chunk will take (real-time chunking).
            prev_chunk_left_over: what is left of the chunk in execution, normalised, from the current step
                on; zeros behind its end do not count. The new chunk continues it: as trained with
                ``warm_start=prefix``, else by guidance; with ``objective=two_step`` as ``execution`` says.
            execution_horizon: control steps of the left-over to continue; all by default.
            envs: the environments that the rows of the batch are, if not 0, 1, ...: whose noise they get.
        """
        self.eval()
        alone = inference_delay is not None  # the engine shows observations from time to time, not every step
        window = self._window_of(batch, alone=alone)
        delay, left_over = inference_delay or 0, (prev_chunk_left_over, execution_horizon)
        plan = self._left_over(left_over[0], delay, left_over[1])
        start = self._continuation
        keyframes = self._sample(window, envs, 1, noise=noise, plan=plan, start=start)[0]
        chunk = self._control_steps(keyframes, self.config.timing.control_steps)
        return chunk if start != "none" else self._handed_over(chunk, left_over[0], delay, left_over[1])

    @property
    def _continuation(self) -> Literal["prefix", "rtc", "none"]:
        """How sampling continues a chunk in real time; regression from noise has nothing to guide."""
        if self.config.warm_start == "prefix":
            return "prefix"
        return "none" if self.config.objective == "two_step" else "rtc"

    @acting
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
        chosen = self._samplers.get(sampler, num_inference_steps, timestep_spacing)
        window = self._window_of(batch)
        keyframes = self._sample(window, None, n_samples, noise=noise, sampler=chosen)
        chunks = self._control_steps(keyframes.flatten(0, 1), self.config.timing.control_steps)
        return chunks.unflatten(0, keyframes.shape[:2])

    def _prepare(
        self, window: Observation, envs: Environments, n_steps: int, delay: int
    ) -> Callable[[], Tensor]:
        settings, start = self._action_queue.settings, self.config.warm_start
        n_samples = settings.n_samples or 1
        noise = self._held(envs, window.batch_size) if start == "noise_hold" else None
        plan = self._current_plan(envs, delay) if start in ("sdedit", "rtc", "prefix") else None

        def predict() -> Tensor:
            keyframes = self._sample(window, envs, n_samples, noise=noise, plan=plan, start=start)
            chunks = self._control_steps(keyframes.flatten(0, 1), n_steps)
            return chunks if settings.n_samples is None else chunks.unflatten(0, (n_samples, -1))

        return predict

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
        n_envs, shape = window.batch_size, (self.config.horizon, *self.feature_spec.action)
        if noise is None:
            noise = self._noise.draw(n_envs, shape, envs=envs, n_samples=n_samples)
        noise = noise.reshape(n_samples * n_envs, *shape).to(self._example)
        generators = self._noise.generators(n_envs, envs, n_samples)
        sampler = sampler or self._samplers.get()
        denoising = Denoising(self._network, self.process, self.config.guidance_scale)
        if plan is None or start == "none":
            chunks = denoising.sample(window, sampler, noise, generators)
        elif start == "sdedit":
            late = self._samplers.get(strength=self.config.sdedit_strength)
            chunks = denoising.edit(window, (late, sampler), noise, generators, plan.repeat(n_samples))
        elif start == "prefix":
            whole = plan.whole_tokens(self.config.actions_per_token, self.config.prefix_tokens)
            chunks = denoising.sample(window, sampler, noise, generators, prefix=whole.repeat(n_samples))
        else:
            towards = (plan.repeat(n_samples), Guidance.from_config(self.config))
            chunks = denoising.sample(window, sampler, noise, generators, towards=towards)
        return chunks.unflatten(0, (n_samples, n_envs))

    def _held(self, envs: Environments, n_envs: int) -> Float[Tensor, "n T A"]:
        """Noise that stays with the control steps that it was drawn for."""
        (action_dim,) = self.feature_spec.action
        first = self._action_queue.n_steps // self.config.chunk_stride
        return self._held_noise.draw(n_envs, (self.config.horizon, action_dim), first, envs=envs)

    @property
    def _example(self) -> Tensor:
        """A weight, for its device and precision."""
        return next(self.model.parameters())

    def _reset_draws(self, envs: list[int] | None) -> None:
        if envs is None:
            self._noise = NoiseSource(self.config.noise_seed, self._episodes)
            self._held_noise = NoiseHold(self._noise)
            self._samplers = ConfiguredSamplers(self.config, self.process)
        else:
            self._noise.reset(envs)
            self._held_noise.reset(envs)

    def init_rtc_processor(self) -> None:
        """Refuse a mode that was not learned; LeRobot calls this when it has set ``rtc_config``."""
        super().init_rtc_processor()
        check_rtc_mode(self.config.rtc_config, learned_prefixes=self.config.warm_start == "prefix")

    def _get_default_peft_targets(self) -> dict[str, Any]:
        """Adapt the denoiser's layers, and how time and observation modulate them; train its last one."""
        return {
            "target_modules": rf"model\.denoiser\.({DENOISERS[self.config.denoiser].adapted})",
            "modules_to_save": ["denoiser.contract"],
        }
