"""The settings of chunk execution, under the same names in every policy of this package."""

from dataclasses import dataclass, field

from lerobot_act_chunking.execution.settings import ExecutionSettings, Kernel, Mode, Weighting


@dataclass
class ExecutionFields:
    """Mixin for policy configurations; see `ExecutionSettings` for what the fields do.

    ``None`` stays ``None`` in a saved configuration: it stands for the default of the mode, so that
    ``--policy.execution=ensemble`` alone changes a trained policy's execution.
    """

    execution: Mode = "open_loop"
    replan_interval: int | None = None
    latency_steps: int = 0
    temporal_ensemble_coeff: float | None = None
    ensemble_weighting: Weighting | None = None
    crossfade_steps: int | None = None
    adaptive_kernel: Kernel | None = None
    adaptive_scale: float | None = None
    n_samples: int | None = None
    gripper_dims: list[int] = field(default_factory=list)

    def resolve_execution(self, chunk_size: int, n_action_steps: int | None) -> ExecutionSettings:
        """The settings for chunks of ``chunk_size`` control steps.

        Raises:
            ConfigurationError: a combination that makes no sense.
        """
        return ExecutionSettings(
            chunk_size=chunk_size,
            n_action_steps=n_action_steps,  # pyright: ignore[reportArgumentType]  (None: all)
            execution=self.execution,
            replan_interval=self.replan_interval,  # pyright: ignore[reportArgumentType]  (None: the mode's)
            latency_steps=self.latency_steps,
            temporal_ensemble_coeff=self.temporal_ensemble_coeff,
            ensemble_weighting=self.ensemble_weighting,
            crossfade_steps=self.crossfade_steps,
            adaptive_kernel=self.adaptive_kernel,
            adaptive_scale=self.adaptive_scale,
            n_samples=self.n_samples,
            gripper_dims=tuple(self.gripper_dims),
        )
