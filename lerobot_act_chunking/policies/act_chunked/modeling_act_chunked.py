"""The `act_chunked` policy: ACT's wiring of the package's blocks into LeRobot's contract."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

import torch
from jaxtyping import Float
from lerobot.utils.constants import OBS_STATE
from torch import Tensor, nn

from lerobot_act_chunking.data.batch import ActionTarget, Observation
from lerobot_act_chunking.data.masking import hold_padding
from lerobot_act_chunking.execution.environments import Environments
from lerobot_act_chunking.execution.plan import Plan
from lerobot_act_chunking.nn.augment import random_shift
from lerobot_act_chunking.nn.autoregressive import corrupt
from lerobot_act_chunking.nn.history_dropout import drop_history, history_dropout_mask
from lerobot_act_chunking.nn.prefix import begun_with, draw_prefix
from lerobot_act_chunking.policies.act_chunked.building import build_network
from lerobot_act_chunking.policies.act_chunked.configuration_act_chunked import ActChunkedConfig
from lerobot_act_chunking.policies.act_chunked.draws import ActingDraws, Draws
from lerobot_act_chunking.policies.act_chunked.language import body_of, start_from_language
from lerobot_act_chunking.policies.act_chunked.network import ActNetwork, TrainingBatch
from lerobot_act_chunking.policies.act_chunked.vae_loss import VaeLoss
from lerobot_act_chunking.policies.acting import acting
from lerobot_act_chunking.policies.batch_seeds import BatchSeeds
from lerobot_act_chunking.policies.chunked_policy import Batch, ChunkedPolicy
from lerobot_act_chunking.policies.continuing import given_actions
from lerobot_act_chunking.policies.finite_loss import finite_terms


class ActChunkedPolicy(ChunkedPolicy[ActChunkedConfig, ActNetwork]):
    """Action Chunking with Transformers (Zhao et al. 2023) over any mix of state vectors and cameras."""

    config_class = ActChunkedConfig  # pyright: ignore[reportAssignmentType]  (LeRobot declares None)
    name = "act_chunked"  # pyright: ignore[reportAssignmentType]
    _fsdp_wrap_modules = ["EncoderLayer", "DecoderLayer"]  # noqa: RUF012 (LeRobot's declaration of its type)

    def __init__(self, config: ActChunkedConfig, **kwargs: Any):
        super().__init__(config, **kwargs)
        if config.encoder_init != "random" and kwargs.get("load_backbone_weights", True):
            start_from_language(self.model.encoder, config)
            if self.ema is not None:
                self.ema.restart(self.model)
        if config.compile_model:  # in place: the names of the weights stay
            network = self.model
            for part in (
                network.observation_encoder,
                network.style_encoder,
                network.encoder,
                network.decoder,
            ):
                if part is not None:
                    part.compile(dynamic=True)

    def _build(self, backbone_weights: str | None) -> ActNetwork:
        config = self.config
        self.batch_seeds = BatchSeeds() if config.training_is_stochastic else None
        self.style_lesson = VaeLoss(config) if config.use_vae else None
        return build_network(config, backbone_weights)

    @property
    def _backbone(self) -> nn.Module | None:
        cameras = self.model.observation_encoder.cameras
        return None if cameras is None else cameras.backbone

    def update(self) -> None:
        """Follow the weights with their average, and the schedule of the latent's loss."""
        super().update()
        if self.style_lesson is not None:
            self.style_lesson.advance()

    def forward(
        self, batch: Batch, reduction: Literal["mean", "none"] = "mean"
    ) -> tuple[Tensor, dict[str, float]]:
        """Training loss: how far off or how unlikely the actions are, and the divergence of their style.

        With a latent, training mode learns from the style that the actions show; evaluation mode scores the
        one that the policy acts with.

        Args:
            batch: observations, ``action`` (B, T, A) and ``action_is_pad`` (B, T).
            reduction: ``mean`` for a scalar; ``none`` for one loss per sample (B,), with the same mean.

        Returns:
            The loss, and its terms as plain numbers: ``l1_loss`` (or that of another likelihood), and with a
            latent ``kld_loss`` and its health (`VaeLoss`).

        Raises:
            FeatureError: naming a key that is missing or has another shape than the policy was built for.
            DatasetError: if the loss is not finite, naming the first key that holds a NaN or an infinity.
        """
        generator = self._next_generator()
        training_batch = self._training_batch(batch, generator)
        if self.style_lesson is None:
            loss = self._network.loss(training_batch, None, self.config.pad_normalization)
            terms = {self.config.loss_name: loss.mean()}
        else:
            loss, terms = self.style_lesson(self._network, training_batch, generator)
        metrics = finite_terms(loss, terms, batch, self.feature_spec.keys)
        loss = self._balanced(loss, batch)
        return (loss.mean() if reduction == "mean" else loss), metrics

    def _next_generator(self) -> torch.Generator | None:
        """What everything random in the next batch is drawn from."""
        if self.batch_seeds is None:
            return None
        return self.batch_seeds.next_generator(self.model.style_token.device)

    def _training_batch(self, batch: Batch, generator: torch.Generator | None) -> TrainingBatch:
        config = self.config
        target = ActionTarget.from_lerobot(batch, self.feature_spec, config.action_delta_indices)
        actions = hold_padding(target.actions, target.is_pad)
        window = self._training_window(batch, target)
        decoder_inputs, mask, given, ignored = actions, None, None, target.is_pad
        if self.training and generator is not None:
            window = self._augmented(window, generator)
            if config.decoder_type == "autoregressive":
                noise, dropout = config.teacher_noise_std, config.teacher_dropout
                decoder_inputs, mask = corrupt(actions, config.actions_per_query, generator, noise, dropout)
            if config.prefix_steps:
                given, which = draw_prefix(actions, config.prefix_predictions, generator)
                ignored = ignored | which
        state = window.vectors.get(OBS_STATE)
        return TrainingBatch(
            observation=self._network.encode_observation(window, given),
            state=None if state is None else state[:, -1],
            target=ActionTarget(actions, target.is_pad),
            ignored=ignored,
            decoder_inputs=decoder_inputs,
            decoder_input_mask=mask,
        )

    def _augmented(self, window: Observation, generator: torch.Generator) -> Observation:
        """The observations as training sees them."""
        if self.config.history_dropout:
            forget = history_dropout_mask(window.batch_size, self.config.history_dropout, generator)
            window = replace(
                window,
                vectors=drop_history(window.vectors, forget),
                images=drop_history(window.images, forget),
            )
        if self.config.random_shift:
            images = {
                key: random_shift(value, self.config.random_shift, generator)
                for key, value in window.images.items()
            }
            window = replace(window, images=images)
        return window

    @acting
    def predict_action_chunk(
        self,
        batch: Batch,
        noise: Float[Tensor, "B L"] | None = None,
        draws: Float[Tensor, "B *S"] | None = None,
        inference_delay: int | None = None,
        prev_chunk_left_over: Float[Tensor, "*B P A"] | None = None,
        execution_horizon: int | None = None,
        envs: Environments = None,
        **_: Any,
    ) -> Tensor:
        """The whole chunk of normalised actions (B, T, A), one per control step.

        Observations with a time axis (B, n_obs_steps, ...) are used as they are. Others are added to those of
        earlier calls, as in `select_action`: use one or the other in a rollout.

        Args:
            batch: observations.
            noise: standard normal numbers (B, L) that the latent is made from; by default the environments'
                generators draw them, if a latent is sampled.
            draws: uniform numbers by which the head samples actions, likewise.
            inference_delay, prev_chunk_left_over, execution_horizon: see `ContinuesChunks`.
            envs: the environments that the rows of the batch are, if not 0, 1, ...
        """
        self.eval()
        window = self._window_of(batch, alone=inference_delay is not None)
        drawn = self._draws.draw(window.batch_size, envs=envs, step=self._action_queue.n_steps).flat()
        chosen = Draws(drawn.latent if noise is None else noise, drawn.actions if draws is None else draws)
        delay = inference_delay or 0
        plan = self._left_over(prev_chunk_left_over, delay, execution_horizon)
        chunk = self._chunks(window, chosen, 1, self.config.timing.control_steps, plan)[0]
        return self._handed_over(chunk, prev_chunk_left_over, delay, execution_horizon)

    @acting
    def predict_samples(self, batch: Batch, n_samples: int) -> Float[Tensor, "N B K A"]:
        """Several chunks for each observation, from now on at every control step.

        Args:
            batch: observations, as for `predict_action_chunk`.
            n_samples: N, chunks per observation.
        """
        self.eval()
        window = self._window_of(batch)
        drawn = self._draws.draw(window.batch_size, n_samples=n_samples, step=self._action_queue.n_steps)
        return self._chunks(window, drawn.flat(), n_samples, self.config.timing.control_steps)

    def _prepare(
        self, window: Observation, envs: Environments, n_steps: int, delay: int
    ) -> Callable[[], Tensor]:
        n_samples = self._action_queue.settings.n_samples
        drawn = self._draws.draw(
            window.batch_size, envs=envs, n_samples=n_samples or 1, step=self._action_queue.n_steps
        )
        plan = self._current_plan(envs, delay) if self.config.prefix_steps else None

        def predict() -> Tensor:
            chunks = self._chunks(window, drawn.flat(), n_samples or 1, n_steps, plan)
            return chunks[0] if n_samples is None else chunks

        return predict

    def _chunks(
        self, window: Observation, draws: Draws, n_samples: int, n_steps: int, plan: Plan | None = None
    ) -> Float[Tensor, "N n K A"]:
        """The first ``n_steps`` of the chunks that these draws make, and that continue the plan."""
        config, network = self.config, self._network
        n_queries = math.ceil(config.timing.predictions_for(n_steps) / config.actions_per_query)
        given = given_actions(plan, config.prefix_predictions)
        encoded = network.encode_observation(window, given).repeat(n_samples)
        latent, actions = (None if each is None else each.to(encoded.tokens) for each in draws)
        predictions = network.act(encoded, network.prior(encoded, latent), actions, n_queries)
        if given is not None:
            predictions = begun_with(given.repeat(n_samples), predictions)
        return self._control_steps(predictions, n_steps).unflatten(0, (n_samples, -1))

    def get_optim_params(self) -> list[dict[str, Any]]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Parameter groups for the optimiser: a text encoder's body learns at its own rate."""
        groups = super().get_optim_params()
        body = body_of(self.model.encoder)
        if not body:
            return groups
        in_body = set(body)
        rest = [{**group, "params": [p for p in group["params"] if p not in in_body]} for group in groups]
        return [*rest, {**groups[0], "params": body, "lr": self.config.optimizer_lr_encoder}]

    def _image_features(self, observation: Observation) -> dict[str, Tensor]:
        return self._network.observation_encoder.image_features(observation.images)

    def _reset_draws(self, envs: list[int] | None) -> None:
        if envs is None:
            config = self.config
            latent = self.model.latent if config.use_vae and config.z_inference == "sample" else None
            self._draws = ActingDraws(
                config.noise_seed,
                n_noise=None if latent is None else latent.n_noise,
                draws_shape=self.model.head.draws_shape or None,
                hold_steps=config.hold_steps,
                episodes=self._episodes,
            )
        else:
            self._draws.reset(envs)

    def _get_default_peft_targets(self) -> dict[str, Any]:
        """Adapt all attention projections and feed-forward layers of the encoder and decoder."""
        return {
            "target_modules": r"model\.(encoder|decoder)\..*\.([qkv]_proj|out_proj|expand|contract)",
            "modules_to_save": ["head"],
        }
