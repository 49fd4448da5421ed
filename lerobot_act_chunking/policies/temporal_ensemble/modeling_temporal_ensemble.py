"""The `temporal_ensemble` policy: chunk execution over any other policy."""

import inspect
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal, Self

from lerobot.policies.factory import get_policy_class
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import Tensor

from lerobot_act_chunking import compat
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.execution.environments import Environments
from lerobot_act_chunking.execution.executor import ChunkExecutor
from lerobot_act_chunking.heads.action_head import at_least_single
from lerobot_act_chunking.policies import late_chunks
from lerobot_act_chunking.policies.acting import acting
from lerobot_act_chunking.policies.chunked_policy import ChunkedPolicy
from lerobot_act_chunking.policies.continuing import continue_chunk, to_continue
from lerobot_act_chunking.policies.environments import indices
from lerobot_act_chunking.policies.language.watch import InstructionWatch
from lerobot_act_chunking.policies.limits import ActsWithinLimits
from lerobot_act_chunking.policies.model_card import WithModelCard
from lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble import (
    TemporalEnsembleConfig,
)
from lerobot_act_chunking.policies.temporal_ensemble.inner import check_downloads, for_chunks
from lerobot_act_chunking.policies.temporal_ensemble.observations import Batch, InnerObservations, private
from lerobot_act_chunking.policies.temporal_ensemble.short_episodes import limit_execution

RTC_ARGUMENTS = ("inference_delay", "prev_chunk_left_over", "execution_horizon")


class TemporalEnsemblePolicy(ActsWithinLimits, WithModelCard, PreTrainedPolicy):
    """Executes the chunks of an inner policy as its settings say; everything else is the inner policy's.

    Batches are the inner policy's, normalised by its own processors. None is ever changed.

    Attributes:
        inner: the policy that predicts; its own execution (queues, ensembling) is never used.
    """

    config_class = TemporalEnsembleConfig  # pyright: ignore[reportAssignmentType]  (LeRobot declares None)
    name = "temporal_ensemble"  # pyright: ignore[reportAssignmentType]

    def __init__(self, config: TemporalEnsembleConfig, *, load_inner: bool = True, **dataset: Any):
        """Build the inner policy, from its checkpoint if it has one, and wrap it.

        Args:
            config: the settings, with input and output features.
            load_inner: load the inner policy's own checkpoint; not if a checkpoint of the wrapper follows.
            dataset: LeRobot's ``dataset_stats`` and ``dataset_meta``, for the inner policy.

        Raises:
            ConfigurationError: the inner checkpoint does not exist.
        """
        super().__init__(config)
        config.validate_features()
        self.config = config
        if load_inner and config.inner_source is None:
            config.choose_backbone()
        meta = dataset.get("dataset_meta")
        if meta is not None and meta.episodes is not None and load_inner and config.inner_source is None:
            config.fit_to_dataset(meta)
            limit_execution(config, max(meta.episodes["length"]))
        if meta is not None and meta.episodes is not None:
            config.remember(meta)
        self.inner = _build_inner(config, config.inner_source if load_inner else None, dataset, load_inner)
        self._observations = InnerObservations(self.inner)
        if load_inner and config.inner_source is not None and meta is None:
            self.set_limits(config.inner_source)
        self.reset()

    @classmethod
    def from_pretrained(cls, pretrained_name_or_path: str | Path, **kwargs: Any) -> Self:
        """Load a checkpoint of the wrapper, inner policy included; one that does not fit is refused."""
        kwargs = {"strict": True, "load_inner": False, **kwargs}
        policy = super().from_pretrained(pretrained_name_or_path, **kwargs)
        if kwargs.get("dataset_meta") is None:  # else it is trained, and its processors are made afterwards
            policy.set_limits(pretrained_name_or_path, revision=kwargs.get("revision"))
        return policy

    def forward(
        self, batch: Batch, reduction: Literal["mean", "none"] = "mean"
    ) -> tuple[Tensor, dict[str, Any] | None]:
        """The inner policy's training loss.

        Args:
            batch: as the inner policy takes it.
            reduction: ``mean`` for a scalar; ``none`` for one loss per sample (B,).

        Raises:
            ConfigurationError: the inner policy does not compute losses per sample.
        """
        if reduction == "mean":
            return self.inner.forward(private(batch))
        if "reduction" not in _parameters(self.inner.forward):
            raise ConfigurationError(
                f"sample weighting needs one loss per sample, which {self.inner.name} does not compute: "
                "set --sample_weighting=null"
            )
        return self.inner.forward(private(batch), reduction=reduction)  # pyright: ignore[reportCallIssue]

    @acting
    def predict_action_chunk(self, batch: Batch, **kwargs: Any) -> Tensor:
        """The inner policy's whole chunk of normalised actions (B, T, A); needs no earlier call.

        With an inner policy that observes several steps, each call adds its observations to the history, as
        `select_action` does: use one or the other in a rollout. Observations with a time axis (B, H, ...)
        are a history themselves and leave ours alone.

        Args:
            batch: observations.
            kwargs: for the inner policy. ``inference_delay``, ``prev_chunk_left_over`` and
                ``execution_horizon`` (real-time chunking) are passed on to one that continues chunks; of
                another one, the chunk goes over from what is left as ``execution`` says.
        """
        if not self._observations.has_own_history(batch):
            self._observations.observe(batch)
        if self._inner_continues:
            return self._predictor(batch, None, **kwargs)()
        asked = {name: kwargs.pop(name, None) for name in RTC_ARGUMENTS}
        chunk = self._predictor(batch, None, **kwargs)()
        steps = to_continue(self.config, asked["prev_chunk_left_over"], asked["execution_horizon"])
        return continue_chunk(chunk, steps, asked["inference_delay"] or 0, self._action_queue.settings)

    @acting
    def select_action(self, batch: Batch, **_: Any) -> Tensor:
        """The normalised action (B, A) of this control step. Call `reset` at the start of each rollout."""
        self._observations.observe(batch)
        batch_size = self._observations.batch_size(batch)
        changed = self._instructions.changed(batch)
        if changed is not None:  # what waits was meant for another instruction
            self._action_queue.clear(changed)
        action = self._action_queue.advance(lambda envs, _: self._prepare(batch, envs), batch_size)
        return self.within_limits(action)

    def _prepare(self, batch: Batch, envs: Environments) -> Callable[[], Tensor]:
        """What computes the chunks that execution asks for, perhaps while actions are executed."""
        n_samples = self._action_queue.settings.n_samples
        predict = self._predictor(batch, envs, n_samples or 1)
        return lambda: self._checked(predict(), n_samples)

    def _checked(self, chunks: Tensor, n_samples: int | None) -> Tensor:
        """The chunks (n, T, A); several of each, (N, n, T, A), to choose from."""
        needed = self._action_queue.settings.n_action_steps
        if chunks.shape[1] < needed:
            raise ConfigurationError(
                f"the inner {self.inner.name} predicts chunks of {chunks.shape[1]} actions, fewer than the "
                f"{needed} to execute: set --policy.n_action_steps={chunks.shape[1]}"
            )
        return chunks if n_samples is None else chunks.unflatten(0, (n_samples, -1))

    def _predictor(
        self, batch: Batch, envs: Environments, n_samples: int = 1, **kwargs: Any
    ) -> Callable[[], Tensor]:
        """What computes chunks from the observations of now."""
        if self.training:
            self.eval()
        if envs is not None and isinstance(self.inner, ChunkedPolicy):
            kwargs["envs"] = envs.repeat(n_samples)
        observations = self._observations.for_prediction(batch, envs, n_samples)
        return lambda: at_least_single(_chunk(self.inner, observations, **kwargs))

    def reset(
        self, envs: Sequence[int] | Tensor | None = None, *, episode_seeds: Sequence[int] | None = None
    ) -> None:
        """Forget all chunks and observations: a new episode begins, in all environments or in these alone.

        Args:
            envs: indices, or a mask over all environments; None for all.
            episode_seeds: one for each of ``envs``, or for the environments 0, 1, ...; an inner policy of
                this package draws by them, see `ChunkedPolicy.reset`.
        """
        if envs is None:
            self._observations.reset()
            self._instructions = InstructionWatch()
            if hasattr(self, "_action_queue"):
                self._action_queue.reset()  # waits for a chunk that is being computed
            # LeRobot and its tools look for a queue under this name to learn when the next inference is due.
            self._action_queue = ChunkExecutor(self.config.execution_settings)
        else:
            envs = indices(envs)
            self._observations.reset(envs)
            self._action_queue.reset(envs)
        if self.limits is not None:
            self.limits.reset(envs)
        if isinstance(self.inner, ChunkedPolicy):
            self.inner.reset(envs, episode_seeds=episode_seeds)
        elif envs is None:
            self.inner.reset()

    @property
    def _inner_continues(self) -> bool:
        """Whether the inner policy continues a chunk that is being executed by itself."""
        parameters = _parameters(self.inner.predict_action_chunk)
        takes_any = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values())
        takes = takes_any or all(name in parameters for name in RTC_ARGUMENTS[:2])
        return takes and self.inner.supports_rtc()

    def supports_rtc(self) -> bool:
        """Chunks continue those that are being executed (real-time chunking), whatever the inner policy."""
        return True

    def init_rtc_processor(self) -> None:
        """Hand the settings of real-time chunking, which LeRobot left in our configuration, to the inner."""
        late_chunks.install(self)
        vars(self.inner.config)["rtc_config"] = getattr(self.config, "rtc_config", None)
        initialise = getattr(self.inner, "init_rtc_processor", None)
        if initialise is not None:
            initialise()

    def supports_text_generation(self) -> bool:
        """Whether the inner policy answers questions (LeRobot 0.7)."""
        return compat.generates_text(self.inner)

    def generate_text(self, batch: Batch) -> str:
        """The inner policy's answer to the question in ``batch``."""
        return self.inner.generate_text(private(batch))  # pyright: ignore[reportCallIssue]

    def update(self) -> None:
        """Let the inner policy follow its weights; LeRobot calls this after every optimiser step."""
        update = getattr(self.inner, "update", None)
        if update is not None:
            update()

    def get_optim_params(self) -> Any:
        """The inner policy's parameters for the optimiser."""
        return self.inner.get_optim_params()

    def _get_default_peft_targets(self) -> dict[str, Any] | None:
        """The inner policy's, by the names that its modules have here."""
        targets = self.inner._get_default_peft_targets()
        pattern = None if targets is None else targets.get("target_modules")
        if targets is None or not isinstance(pattern, str):  # a list names the ends of names
            return targets
        return {**targets, "target_modules": rf"inner\.({pattern})"}

    def _validate_peft_config(self, peft_config: Any) -> None:
        super()._validate_peft_config(peft_config)
        if isinstance(self.inner, ChunkedPolicy):
            self.inner.check_takes_adapters()


def _build_inner(
    config: TemporalEnsembleConfig, source: str | None, dataset: dict[str, Any], load_inner: bool
) -> PreTrainedPolicy:
    """The inner policy that hands out whole chunks; with the weights at ``source``, if there is one."""
    inner = for_chunks(config.inner_config, weights_follow=source is not None or not load_inner)
    policy_class = get_policy_class(inner.type)
    if source is None:
        check_downloads(inner)
        return policy_class(inner, **dataset)
    return policy_class.from_pretrained(source, config=inner, **dataset)


def _chunk(inner: PreTrainedPolicy, observations: Batch, **kwargs: Any) -> Tensor:
    """The inner policy's chunk (B, T, A)."""
    if inner.name != "tdmpc":
        return compat.action_of(inner.predict_action_chunk(observations, **kwargs))
    # Its planner would start from its last plan, which may be for other environments or several steps old.
    inner._prev_mean = None
    return compat.action_of(inner.predict_action_chunk(observations, **kwargs)).transpose(0, 1)


def _parameters(function: Callable) -> Any:
    return inspect.signature(function).parameters
