"""What this package's policies have in common: LeRobot's contract around a network that predicts chunks."""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import torch
from jaxtyping import Float
from lerobot.policies.pretrained import PreTrainedPolicy
from torch import Tensor, nn

from lerobot_act_chunking.data.batch import ActionTarget, Observation, has_time_axis
from lerobot_act_chunking.data.window import ObservationWindow
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.execution.environments import Environments
from lerobot_act_chunking.execution.executor import ChunkExecutor
from lerobot_act_chunking.execution.interpolation import upsample
from lerobot_act_chunking.nn.ema import WeightAverage
from lerobot_act_chunking.policies.acting import acting
from lerobot_act_chunking.policies.averages import adopt_average
from lerobot_act_chunking.policies.backbone_choice import choose_backbone
from lerobot_act_chunking.policies.batch_seeds import BatchSeeds
from lerobot_act_chunking.policies.chunked_config import ChunkedConfig
from lerobot_act_chunking.policies.continuing import ContinuesChunks
from lerobot_act_chunking.policies.dataset_defaults import fit_to_dataset
from lerobot_act_chunking.policies.environments import indices
from lerobot_act_chunking.policies.language.following import FollowsInstructions
from lerobot_act_chunking.policies.limits import ActsWithinLimits
from lerobot_act_chunking.policies.mode_balance import ModeBalance
from lerobot_act_chunking.policies.model_card import WithModelCard
from lerobot_act_chunking.policies.sharding import ShardsByLayer
from lerobot_act_chunking.policies.short_episodes import fit_to_episodes
from lerobot_act_chunking.policies.size import check_size
from lerobot_act_chunking.policies.statistics import check_statistics
from lerobot_act_chunking.sampling.episodes import Episodes

FUSED_ADAMW_DEVICES = ("cpu", "cuda", "mps")

Batch = dict[str, Any]


class ChunkedPolicy[ConfigT: ChunkedConfig, NetworkT: nn.Module](
    ContinuesChunks, FollowsInstructions, ActsWithinLimits, ShardsByLayer, WithModelCard, PreTrainedPolicy
):
    """Base of the policies: checks, weight averaging, checkpoints, and chunks executed one action at a time.

    A policy adds ``config_class``, ``name``, its network, `forward` and `_prepare`. Batches are LeRobot's:
    normalised, on the policy's device. None is ever changed.

    Args:
        config: its settings, with input and output features.
        dataset_stats: statistics of the training data, checked if given.
        dataset_meta: LeRobot's metadata of the training data, checked if given. The length and the execution
            of chunks follow from it unless they were given (`fit_to_dataset`), and no more of a chunk is
            executed than its longest episode taught, unless ``n_action_steps`` was given.
        load_backbone_weights: choose and fill in pretrained weights; not if a checkpoint follows.

    Raises:
        FeatureError: if inputs or outputs cannot work.
        ConfigurationError: if pretrained weights are not cached.
        DatasetError: if the statistics are not finite.
    """

    config_class = ChunkedConfig  # pyright: ignore[reportAssignmentType]  (LeRobot declares None)
    name = "chunked"  # pyright: ignore[reportAssignmentType]
    config: ConfigT
    model: NetworkT
    ema: WeightAverage[NetworkT] | None

    def __init__(
        self,
        config: ConfigT,
        *,
        dataset_stats: dict[str, dict[str, Any]] | None = None,
        dataset_meta: Any | None = None,
        load_backbone_weights: bool = True,
        **_: Any,
    ):
        super().__init__(config)
        config.validate_features()
        config.keep_what_is_read()
        if load_backbone_weights:
            choose_backbone(config)
        if dataset_meta is not None and dataset_meta.episodes is not None:
            config.check_dataset(dataset_meta.features, dataset_meta)
            config.check_fps(dataset_meta.fps)
            lengths = dataset_meta.episodes["length"]
            if load_backbone_weights:
                fit_to_dataset(config, dataset_meta)
            fit_to_episodes(config, max(lengths), weights_follow=not load_backbone_weights)
            config.remember(dataset_meta)
        if dataset_stats is not None:
            check_statistics(config, dataset_stats)
        self.config = config
        self.feature_spec = config.feature_spec
        self._load_instruction_encoder(dataset_meta)
        check_size(lambda: self._build(None))
        balanced = config.balance_modes != "none" and dataset_meta is not None
        self.mode_balance = ModeBalance.of_dataset(config, dataset_meta) if balanced else None
        self.model = self._build(config.pretrained_backbone_weights if load_backbone_weights else None)
        if dataset_meta is not None and load_backbone_weights:
            self._read_all_instructions()
        self.ema = (
            WeightAverage(self.model, power=config.ema_power, max_value=config.ema_max_value)
            if config.use_ema
            else None
        )
        self.crop_seeds = BatchSeeds() if config.crops_at_random else None
        self.register_load_state_dict_post_hook(adopt_average)
        self._episodes = Episodes()
        self.reset()

    @abstractmethod
    def _build(self, backbone_weights: str | None) -> NetworkT:
        """The network that ``self.config`` describes."""

    @abstractmethod
    def _prepare(
        self, window: Observation, envs: Environments, n_steps: int, delay: int
    ) -> Callable[[], Tensor]:
        """What computes the first ``n_steps`` of the chunks (n, T, A), or of N samples (N, n, T, A).

        It is called in evaluation mode, once, perhaps in another thread while actions are executed: all that
        changes from step to step is read here.

        Args:
            window: observations (n, H, ...) of the environments asked for.
            envs: which ones they are; None for all.
            n_steps: control steps needed.
            delay: control steps after which the chunks will be used.
        """

    def _balanced(self, loss: Float[Tensor, " B"], batch: Batch) -> Float[Tensor, " B"]:
        """The losses with which training weighs its samples; evaluation weighs all alike.

        Raises:
            ConfigurationError: ``balance_modes`` without a dataset to know modes from.
        """
        if not self.training or self.config.balance_modes == "none":
            return loss
        if self.mode_balance is None:
            raise ConfigurationError(
                f"balance_modes={self.config.balance_modes} needs the dataset's metadata: give the policy "
                "dataset_meta, as lerobot-train does, or set balance_modes=none"
            )
        return self.mode_balance(loss, batch)

    @property
    @abstractmethod
    def _backbone(self) -> nn.Module | None:
        """The image backbone, which learns at its own rate."""

    @classmethod
    def from_pretrained(cls, pretrained_name_or_path: str | Path, **kwargs: Any) -> Self:
        """Load a checkpoint, as LeRobot, but refuse one that does not fit in place of loading it in part.

        Backbone weights come from the checkpoint, not from torch hub's cache.
        """
        kwargs = {"strict": True, "load_backbone_weights": False, **kwargs}
        policy = super().from_pretrained(pretrained_name_or_path, **kwargs)
        if kwargs.get("dataset_meta") is None:  # else it is trained, and its processors are made afterwards
            policy.set_limits(pretrained_name_or_path, revision=kwargs.get("revision"))
        return policy

    @property
    def _network(self) -> NetworkT:
        """The network in use: the averaged one when acting, if there is one."""
        return self.model if self.ema is None or self.training else self.ema.network

    @acting
    def select_action(self, batch: Batch, **_: Any) -> Tensor:
        """The normalised action (B, A) of this control step. Call `reset` at the start of each rollout."""
        observation = Observation.from_lerobot(batch, self.feature_spec)
        self._drop_what_was_asked_before(batch)
        self._window.push(self._encode_images_on_arrival(observation))

        def prepare(envs: Environments, delay: int) -> Callable[[], Tensor]:
            if self.training:  # switching hundreds of modules takes a tenth of a chunk's time
                self.eval()
            window = self._instructed(self._window.stack(envs), batch, envs)
            return self._prepare(window, envs, self.config.n_action_steps, delay)

        return self.within_limits(self._action_queue.advance(prepare, observation.batch_size))

    def _training_window(self, batch: Batch, target: ActionTarget) -> Observation:
        """The observations (B, H, ...) of a batch to learn from; training sees random parts of images."""
        generator = None
        if self.training and self.crop_seeds is not None:
            generator = self.crop_seeds.next_generator(target.actions.device)
        n_steps = self.config.n_obs_steps
        window = Observation.window_from_lerobot(batch, self.feature_spec, n_steps, target, generator)
        return self._taught(window, batch)

    def _window_of(self, batch: Batch, *, alone: bool = False) -> Observation:
        """The observations (B, H, ...) to predict from.

        They are the batch's own, if it has a time axis; else its step behind those before, or ``alone``.
        """
        if has_time_axis(batch, self.feature_spec, self.config.n_obs_steps):
            window = Observation.window_from_lerobot(batch, self.feature_spec, self.config.n_obs_steps)
            return self._instructed(window, batch)
        window = self._fresh_window() if alone else self._window
        window.push(self._encode_images_on_arrival(Observation.from_lerobot(batch, self.feature_spec)))
        return self._instructed(window.stack(), batch)

    @torch.no_grad()
    def _encode_images_on_arrival(self, observation: Observation) -> Observation:
        """Images as features, if every frame will be needed: encoded early, they do not delay the chunk."""
        if not self._encodes_every_frame:
            return observation
        if self.training:
            self.eval()
        features = self._image_features(observation)
        if features is None:
            return observation
        return replace(observation, vectors=observation.vectors | features, images={})

    def _image_features(self, observation: Observation) -> dict[str, Tensor] | None:
        """Features (B, ...) that the network takes in place of the images; None if it takes images alone."""
        return None

    def _control_steps(self, predictions: Float[Tensor, "n T A"], n_steps: int) -> Float[Tensor, "n K A"]:
        """The first ``n_steps`` from now on, interpolated between predictions."""
        config = self.config
        needed = predictions[:, config.timing.past_steps :][:, : config.timing.predictions_for(n_steps)]
        return upsample(needed, config.chunk_stride, config.gripper_dims)[:, :n_steps]

    def reset(
        self, envs: Sequence[int] | Tensor | None = None, *, episode_seeds: Sequence[int] | None = None
    ) -> None:
        """Forget all observations and chunks: a new episode begins, in all environments or in these alone.

        What a policy draws while acting follows from ``noise_seed``, the environment and how many episodes
        it has had. If the episodes' own seeds are given, it follows from ``noise_seed`` and these alone:
        results then do not depend on how many environments run together.

        Args:
            envs: indices, or a mask over all environments; None for all.
            episode_seeds: one for each of ``envs``, or for the environments 0, 1, ...

        Raises:
            ValueError: not one seed for each environment, or a negative one.
        """
        chosen = None if envs is None else indices(envs).tolist()
        self._episodes.begin(chosen, episode_seeds)
        if envs is None:  # anew, because evaluation may have changed the settings since
            if hasattr(self, "_action_queue"):
                self._action_queue.reset()  # waits for a chunk that is being computed
            # LeRobot and its tools look for a queue under this name to learn when the next inference is due.
            self._action_queue = ChunkExecutor(self.config.execution_settings)
            self._window = self._fresh_window()
            self._forget_instructions()
            every_frame = 1 < self.config.n_obs_steps >= self.config.execution_settings.replan_interval
            self._encodes_every_frame = every_frame and bool(self.feature_spec.images)
        else:
            envs = indices(envs)
            self._action_queue.reset(envs)
            self._window.reset(envs)
        if self.limits is not None:
            self.limits.reset(envs)
        self._reset_draws(chosen)

    @abstractmethod
    def _reset_draws(self, envs: list[int] | None) -> None:
        """Go to the start of these environments' episodes in everything that is drawn; None for all."""

    def _fresh_window(self) -> ObservationWindow:
        return ObservationWindow(self.config.n_obs_steps, self.config.timing.obs_stride)

    def update(self) -> None:
        """Follow the weights with their average; LeRobot calls this after every optimiser step."""
        if self.ema is not None:
            self.ema.update(self.model)

    def get_optim_params(self) -> list[dict[str, Any]]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Parameter groups for the optimiser: the image backbone learns at its own rate.

        The groups ask for PyTorch's fused AdamW, which LeRobot's AdamWConfig cannot: the same update, faster.
        """
        backbone = [] if self._backbone is None else list(self._backbone.parameters())
        in_backbone = set(backbone)
        rest = [p for p in self.model.parameters() if p not in in_backbone]
        groups = [{"params": rest}, {"params": backbone, "lr": self.config.optimizer_lr_backbone}]
        fused = rest[0].device.type in FUSED_ADAMW_DEVICES
        return [{**group, "fused": fused} for group in groups if group["params"]]

    def _validate_peft_config(self, peft_config: Any) -> None:
        super()._validate_peft_config(peft_config)
        self.check_takes_adapters()

    def check_takes_adapters(self) -> None:
        """Refuse PEFT adapters where they would not be in effect.

        Raises:
            ConfigurationError: acting uses averaged weights, which do not follow them.
        """
        if self.ema is not None:
            raise ConfigurationError("use_ema does not follow PEFT adapters: set --policy.use_ema=false")
