"""The settings of chunk execution, under the same names in every policy of this package."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields

from lerobot.configs import PolicyFeature

from act_chunking_runtime.settings import ExecutionSettings, Kernel, Mode, Weighting
from lerobot_act_chunking.errors import ConfigurationError


@dataclass
class ExecutionFields:
    """Mixin for policy configurations; see `ExecutionSettings` for what the fields do.

    ``None`` stays ``None`` in a saved configuration: it stands for the default of the mode, so that
    ``--policy.execution=ensemble`` alone changes a trained policy's execution.
    """

    execution: Mode = "open_loop"
    replan_interval: int | None = None
    latency_steps: int = 0
    background: bool = False
    temporal_ensemble_coeff: float | None = None
    ensemble_weighting: Weighting | None = None
    crossfade_steps: int | None = None
    adaptive_kernel: Kernel | None = None
    adaptive_scale: float | None = None
    n_samples: int | None = None
    smoothing_steps: int | None = None
    gripper_dims: list[int] = field(default_factory=list)

    def resolve_execution(
        self, chunk_size: int, n_action_steps: int | None, action: PolicyFeature | None = None
    ) -> ExecutionSettings:
        """The settings with the mode's defaults filled in.

        Args:
            chunk_size: control steps that a chunk covers.
            n_action_steps: how many of them may be executed; None for all.
            action: the action's feature, once it is known.

        Raises:
            ConfigurationError: a combination that makes no sense.
        """
        check_gripper_dims(self.gripper_dims, action)
        settings = {each.name: getattr(self, each.name) for each in fields(ExecutionFields)}
        settings |= {"n_action_steps": n_action_steps, "gripper_dims": tuple(self.gripper_dims)}
        given = {name: value for name, value in settings.items() if value is not None}
        return ExecutionSettings(chunk_size=chunk_size, **given)


def check_gripper_dims(gripper_dims: Sequence[int], action: PolicyFeature | None) -> None:
    """Refuse dimensions that the action does not have; without the action's feature there is nothing to see.

    Raises:
        ConfigurationError: naming those that there are.
    """
    if action is None or len(action.shape) != 1:
        return
    (n_dims,) = action.shape
    if any(dim >= n_dims for dim in gripper_dims):
        raise ConfigurationError(
            f"gripper_dims={list(gripper_dims)} must be indices of the action's {n_dims} dimensions, 0 to "
            f"{n_dims - 1}"
        )
