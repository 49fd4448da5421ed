"""The `vqbet_chunked` policy: codes and offsets in LeRobot's contract."""

import logging
import math
from collections.abc import Callable
from typing import Any, Literal

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor, nn

from lerobot_act_chunking.data.batch import ACTION, ActionTarget, Observation
from lerobot_act_chunking.data.masking import hold_padding, per_sample_error
from lerobot_act_chunking.execution.environments import Environments
from lerobot_act_chunking.execution.plan import Plan
from lerobot_act_chunking.heads.codes import focal_loss
from lerobot_act_chunking.nn.prefix import begun_with, draw_prefix
from lerobot_act_chunking.nn.processes import counted_together, draw_rows
from lerobot_act_chunking.policies.acting import acting
from lerobot_act_chunking.policies.chunked_policy import Batch, ChunkedPolicy
from lerobot_act_chunking.policies.continuing import given_actions
from lerobot_act_chunking.policies.finite_loss import finite_terms, require_finite_actions
from lerobot_act_chunking.policies.prefix import prefix_predictions
from lerobot_act_chunking.policies.vqbet_chunked.configuration_vqbet_chunked import VqbetChunkedConfig
from lerobot_act_chunking.policies.vqbet_chunked.network import VqbetNetwork, build_network
from lerobot_act_chunking.policies.vqbet_chunked.tokenizer_file import load_for
from lerobot_act_chunking.policies.vqbet_chunked.tokenizer_phase import TokenizerPhase
from lerobot_act_chunking.sampling.held_draws import HeldDraws
from lerobot_act_chunking.sampling.noise import NoiseSource
from lerobot_act_chunking.tokenizers.make import make_tokenizer

logger = logging.getLogger(__name__)


class VqbetChunkedPolicy(ChunkedPolicy[VqbetChunkedConfig, VqbetNetwork]):
    """Behaviour generation with latent actions (VQ-BeT, Lee et al. 2024), from any inputs.

    A tokenizer turns chunks of actions into codes. The policy predicts the codes of the coming chunk, samples
    some, and adds an offset to the chunk they stand for. The tokenizer stands beside the network: what is
    averaged (``use_ema``) are the weights that predict codes, never the codes.
    """

    config_class = VqbetChunkedConfig  # pyright: ignore[reportAssignmentType]
    name = "vqbet_chunked"  # pyright: ignore[reportAssignmentType]
    _fsdp_wrap_modules = ["GptBlock"]  # noqa: RUF012

    def __init__(
        self,
        config: VqbetChunkedConfig,
        *,
        dataset_stats: dict[str, dict[str, Any]] | None = None,
        load_backbone_weights: bool = True,
        **kwargs: Any,
    ):
        super().__init__(
            config, dataset_stats=dataset_stats, load_backbone_weights=load_backbone_weights, **kwargs
        )
        if config.tokenizer_path is not None and load_backbone_weights:
            load_for(config, self.tokenizer, dataset_stats)
        self.register_load_state_dict_post_hook(_settle)
        self._settle()

    def _build(self, backbone_weights: str | None) -> VqbetNetwork:
        config = self.config
        self.tokenizer = make_tokenizer(config.tokenizer_spec)
        self.tokenizer_phase = TokenizerPhase(
            config.tokenizer_steps, joint=config.tokenizer_training == "joint"
        )
        self.windows: Tensor
        self.register_buffer("windows", torch.tensor(config.queries.windows), persistent=False)
        return build_network(config, self.tokenizer, backbone_weights)

    def _settle(self) -> None:
        """Freeze the tokenizer if it has nothing to learn (any more); while it learns alone, no images."""
        phase = self.tokenizer_phase
        self.tokenizer.requires_grad_(phase.joint or phase.comes_first)
        self.config.image_switch.want_images_in(0 if phase.joint else phase.n_left)

    @property
    def _backbone(self) -> nn.Module | None:
        cameras = self.model.history.cameras
        return None if cameras is None else cameras.backbone

    def get_optim_params(self) -> list[dict[str, Any]]:
        """Parameter groups for the optimiser; a tokenizer that learns in this run has one of its own.

        It keeps it when it is done, so that a resumed run finds the groups it saved.
        """
        groups = super().get_optim_params()
        if self.tokenizer_phase.n_steps or self.tokenizer_phase.joint:
            groups.append(
                {
                    "params": list(self.tokenizer.parameters()),
                    "lr": self.config.optimizer_vqvae_lr,
                    "weight_decay": self.config.optimizer_vqvae_weight_decay,
                    "fused": groups[0]["fused"],
                }
            )
        return groups

    def update(self) -> None:
        """Follow the weights with their average, once they learn."""
        if not self.tokenizer_phase.comes_first:
            super().update()

    def forward(
        self, batch: Batch, reduction: Literal["mean", "none"] = "mean"
    ) -> tuple[Tensor, dict[str, float]]:
        """Training loss: the tokenizer's while it learns alone; then codes (focal loss) and offsets (L1).

        Args:
            batch: observations (B, n_obs_steps, ...), and ``action`` and ``action_is_pad`` of the steps
                ``config.action_delta_indices``.
            reduction: ``mean`` for a scalar; ``none`` for one loss per sample (B,), with the same mean.

        Returns:
            The loss, and its terms as plain numbers.

        Raises:
            FeatureError: naming a key that is missing or has another shape than the policy was built for.
            DatasetError: if the loss is not finite, naming the first key that holds a NaN or an infinity.
        """
        self._settle()
        target = ActionTarget.from_lerobot(batch, self.feature_spec, self.config.action_delta_indices)
        actions = hold_padding(target.actions, target.is_pad)
        chunks, is_pad = actions[:, self.windows], target.is_pad[:, self.windows]  # (B, Q, C, A), (B, Q, C)
        losses, terms, keys, rate = [], {}, (ACTION,), "optimizer_vqvae_lr"
        if self.tokenizer_phase.joint or self.tokenizer_phase.comes_first:
            require_finite_actions(actions)
            loss, terms = self._tokenizer_loss(chunks, is_pad)
            losses.append(loss)
        if not losses or self.tokenizer_phase.joint:
            loss, of_policy = self._policy_loss(self._training_window(batch, target), chunks, is_pad)
            losses.append(loss)
            terms |= of_policy
            keys, rate = self.feature_spec.keys, "optimizer_lr"
        loss = torch.stack(losses).sum(0)
        metrics = finite_terms(loss, terms, batch, keys, rate=rate)
        loss = self._balanced(loss, batch)
        return (loss.mean() if reduction == "mean" else loss), metrics

    def _tokenizer_loss(
        self, chunks: Float[Tensor, "B Q C A"], is_pad: Bool[Tensor, "B Q C"]
    ) -> tuple[Float[Tensor, " B"], dict[str, Tensor | float]]:
        learned = self.tokenizer_phase.learn(self.tokenizer, chunks.flatten(0, 1), is_pad.flatten(0, 1))
        loss = learned.loss.unflatten(0, chunks.shape[:2]).mean(1)
        return loss, {"tokenizer_loss": loss.mean(), **learned.metrics}

    def _policy_loss(
        self, window: Observation, chunks: Float[Tensor, "B Q C A"], is_pad: Bool[Tensor, "B Q C"]
    ) -> tuple[Float[Tensor, " B"], dict[str, Tensor]]:
        config, network = self.config, self._network
        samples_and_queries = chunks.shape[:2]
        finite = chunks.nan_to_num(nan=0, posinf=0, neginf=0)  # no code stands for others; the loss tells
        codes = self.tokenizer.encode(finite.flatten(0, 1))
        given, ignored = None, is_pad
        if self.training and config.prefix_steps:
            current, generator = config.n_obs_steps - 1, self.tokenizer_phase.next_generator(chunks.device)
            given, which = draw_prefix(chunks[:, current], prefix_predictions(config), generator)
            ignored = is_pad.clone()
            ignored[:, current] |= which
        features = network(window, config.n_action_pred_token - 1, given).flatten(0, 1)
        logits = network.code_head.logits(features, codes)
        of_codes = (focal_loss(logits, codes, config.focal_gamma) * self._code_weights(codes)).sum(-1)
        acted = codes if config.offset_target == "gt_code" else self._sample_codes(features)
        actions = network.actions(features, acted, self.tokenizer).unflatten(0, samples_and_queries)
        of_codes = _weighted(of_codes.unflatten(0, samples_and_queries), 1 - is_pad.float().mean(-1))
        error = (actions - chunks).abs().flatten(1, 2)
        of_offsets = per_sample_error(error, ignored.flatten(1, 2), "valid")
        right = (logits.argmax(-1) == codes)[:, 0].float().mean()
        terms = {"code_loss": of_codes.mean(), "offset_loss": of_offsets.mean(), "code_accuracy": right}
        return of_codes + config.offset_loss_weight * of_offsets, terms

    def _code_weights(self, codes: Int64[Tensor, "N G"]) -> Float[Tensor, " G"]:
        """Weight of each code's loss: the first code's and the others', or the same for all."""
        config, n_codes = self.config, self.tokenizer.n_codes
        if not self.tokenizer.coarse_to_fine:
            return torch.full((n_codes,), config.primary_code_loss_weight / n_codes, device=codes.device)
        weights = torch.full((n_codes,), config.secondary_code_loss_weight, device=codes.device)
        weights[0] = config.primary_code_loss_weight
        return weights

    def _sample_codes(self, features: Float[Tensor, "N D"]) -> Int64[Tensor, "N G"]:
        """Codes as acting would choose them."""
        generator = self.tokenizer_phase.next_generator(features.device)
        shape = (len(features), self.tokenizer.n_codes)
        draws = draw_rows(torch.rand, shape, generator=generator, device=features.device)
        return self._pick(features, draws)

    @torch.no_grad()
    def _pick(self, features: Float[Tensor, "N D"], draws: Float[Tensor, "N G"]) -> Int64[Tensor, "N G"]:
        config = self.config
        return self._network.code_head.sample(
            features, draws, temperature=config.bet_softmax_temperature, top_p=config.top_p
        )

    @acting
    def predict_action_chunk(
        self,
        batch: Batch,
        noise: Float[Tensor, "B G"] | None = None,
        inference_delay: int | None = None,
        prev_chunk_left_over: Float[Tensor, "*B P A"] | None = None,
        execution_horizon: int | None = None,
        envs: Environments = None,
        **_: Any,
    ) -> Tensor:
        """The whole chunk of normalised actions (B, T, A) from the current step on, one per control step.

        Observations with a time axis (B, n_obs_steps, ...) are used as they are. Others are added to those of
        earlier calls, as in `select_action`: use one or the other in a rollout.

        Args:
            batch: observations.
            noise: uniform numbers (B, G) that pick the codes; by default the environments' generators draw
                them.
            inference_delay, prev_chunk_left_over, execution_horizon: see `ContinuesChunks`.
            envs: the environments that the rows of the batch are, if not 0, 1, ...: whose numbers they get.
        """
        self.eval()
        window, delay = self._window_of(batch, alone=inference_delay is not None), inference_delay or 0
        draws = self._draws.draw(window.batch_size, envs=envs) if noise is None else noise[None]
        plan = self._left_over(prev_chunk_left_over, delay, execution_horizon)
        chunk = self._chunks(window, draws, self.config.timing.control_steps, plan)[0]
        return self._handed_over(chunk, prev_chunk_left_over, delay, execution_horizon)

    @acting
    def predict_samples(
        self, batch: Batch, n_samples: int, *, noise: Float[Tensor, "N B G"] | None = None
    ) -> Float[Tensor, "N B K A"]:
        """Several chunks for each observation, from now on at every control step.

        Args:
            batch: observations, as for `predict_action_chunk`.
            n_samples: N, chunks per observation.
            noise: uniform numbers that pick the codes; by default the environments' generators draw them.
        """
        self.eval()
        window = self._window_of(batch)
        draws = self._draws.draw(window.batch_size, n_samples=n_samples) if noise is None else noise
        return self._chunks(window, draws, self.config.timing.control_steps)

    def _prepare(
        self, window: Observation, envs: Environments, n_steps: int, delay: int
    ) -> Callable[[], Tensor]:
        n_samples = self._action_queue.settings.n_samples
        draws = self._draws.draw(window.batch_size, envs=envs, n_samples=n_samples or 1)
        plan = self._current_plan(envs, delay) if self.config.prefix_steps else None

        def predict() -> Tensor:
            chunks = self._chunks(window, draws, n_steps, plan)
            return chunks[0] if n_samples is None else chunks

        return predict

    def _chunks(
        self, window: Observation, draws: Float[Tensor, "N n G"], n_steps: int, plan: Plan | None = None
    ) -> Float[Tensor, "N n K A"]:
        """The first ``n_steps`` of the chunks that these draws pick, and that continue the plan."""
        if self.tokenizer_phase.comes_first:
            logger.warning(
                "the tokenizer has not learned yet (training step %d)", self.tokenizer_phase.n_learned
            )
        n_samples = len(draws)
        given = given_actions(plan, prefix_predictions(self.config))
        features = self._network.current(window, given).repeat(n_samples, 1)
        codes = self._pick(features, draws.flatten(0, 1).to(features))
        predictions = self._network.actions(features, codes, self.tokenizer)
        if given is not None:
            predictions = begun_with(given.repeat(n_samples), predictions)
        return self._control_steps(predictions, n_steps).unflatten(0, (n_samples, window.batch_size))

    def _image_features(self, observation: Observation) -> dict[str, Tensor]:
        features = self._network.history.image_features(observation.as_window().images)
        return {key: value[:, 0] for key, value in features.items()}

    def _reset_draws(self, envs: list[int] | None) -> None:
        if envs is None:
            source = NoiseSource(self.config.noise_seed, self._episodes)
            hold_steps = math.inf if self.config.code_hold == "episode" else 0.0
            self._draws = HeldDraws(source, (self.tokenizer.n_codes,), torch.rand, hold_steps=hold_steps)
        else:
            self._draws.reset(envs)

    def _get_default_peft_targets(self) -> dict[str, Any]:
        """Adapt the linear layers inside the GPT; train the heads."""
        return {
            "target_modules": r"model\.gpt\.blocks\.\d+\.(qkv|mix|expand|contract)",
            "modules_to_save": ["code_head", "offset_head"],
        }


def _settle(policy: VqbetChunkedPolicy, _incompatible: Any) -> None:
    """After loading: a resumed run may be anywhere in the tokenizer's phase."""
    policy._settle()


def _weighted(loss: Float[Tensor, "B Q"], weight: Float[Tensor, "B Q"]) -> Float[Tensor, " B"]:
    """Losses per sample whose mean over the batch is the weighted mean over all queries."""
    return (loss * weight).sum(1) * len(loss) / counted_together(weight.sum()).clamp_min(1e-6)
